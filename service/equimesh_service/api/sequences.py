"""Routes of sequences: meshes that follow a time-stepper, one round trip for each step."""

import json
import secrets
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import numpy as np
from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_schema.sequences import ANSWER
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.intake import AcceptedMesh, Body, MeshRequest, refusals
from equimesh_service.admission.tasks import MAX_STEP_POINTS, StepPlace
from equimesh_service.api.mesh_requests import MESH_BODY, Format, IdempotencyKey, Prefer, check_key, receive_mesh
from equimesh_service.api.meshes import Waiting
from equimesh_service.api.resources import SequenceList, SequenceResource, sequence_resource
from equimesh_service.api.results import MESH_CONTENT, check_done
from equimesh_service.api.routing import (
    KEY_PROBLEMS,
    MAX_NUMBER,
    Reader,
    ServiceDependency,
    Writer,
    cursor_at,
    moment_of,
    problems,
)
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.store.blobs import MAX_ROW_BYTES
from equimesh_service.store.rows import CANCELED, FAILED, SUCCEEDED, Ending, MeshRow, NewStep, SequenceRow
from equimesh_service.telemetry import stopwatch
from equimesh_service.wire import body as bodies

if TYPE_CHECKING:
    from equimesh_service.admission.steps import Move, PreparedStep

router = APIRouter(prefix="/v1/sequences", tags=["sequences"], responses=KEY_PROBLEMS)

_KEEP = "How many of the last meshes are kept; earlier ones are deleted when the sequence takes a step."
STEP_EXAMPLES: dict[str, Any] = {
    "expression": {
        "summary": "u as a formula, at the time t of this step",
        "value": {"step": 0, "u": {"expression": "tanh(20*(x - 0.5 - t))", "t": 0.05}},
    },
    "nodes": {
        "summary": "u, and a field to transfer, at the nodes of a mesh of 4 x 4 points",
        "value": {
            "step": 0,
            "u": {"nodes": [[0, 0, 0, 0], [0.2, 0.2, 0.2, 0.2], [0.8, 0.8, 0.8, 0.8], [1, 1, 1, 1]]},
            "fields": {"pressure": [[1, 1, 1, 1], [1, 1, 1, 1], [2, 2, 2, 2], [2, 2, 2, 2]]},
        },
    },
    "monitor": {
        "summary": "A field of vectors, and a new monitor that follows a field",
        "value": {
            "step": 0,
            "monitor": {"kind": "curvature", "u": {"field": "heat"}, "smoothing": 0.02},
            "fields": {
                "heat": {"values": [[0, 0, 0, 0], [1, 2, 2, 1], [1, 2, 2, 1], [0, 0, 0, 0]], "transfer": "spline"},
                "flow": {"values": [[[1, 0]] * 4, [[1, 0.5]] * 4, [[1, 0.5]] * 4, [[1, 0]] * 4], "location": "nodes"},
            },
        },
    },
}
_STEP_BODY = {
    "required": True,
    "content": {
        "application/json": {"schema": {"$ref": "#/components/schemas/StepSpec"}, "examples": STEP_EXAMPLES},
        bodies.NPZ: {
            "schema": {
                "type": "string",
                "contentMediaType": "application/octet-stream",
                "description": "Arrays `step` (a number), `u`, and one for each field, of shape (n_xi, n_eta), and the "
                "text `settings`: JSON as StepSettings, which says how fields are carried, and which monitor to take.",
            }
        },
    },
}
# The most bytes of a step in JSON that goes to a worker as it came. A side worker shortens a longer one first.
_MAX_TEXT_BYTES = 256 * 1024
# The most points of a mesh whose velocity is in JSON answers.
_MAX_VELOCITY_POINTS = 10_000
_TEXT = {"type": "string"}
_HEADERS = {
    "Location": {"description": "The sequence; of a step, its mesh.", "schema": _TEXT},
    "Equimesh-Step": {"description": "The number of the step.", "schema": _TEXT},
}
_ANSWERS: dict[int | str, dict[str, Any]] = {
    201: {
        "description": "The finished mesh with its sequence; its file, when a mesh format was requested.",
        "model": SequenceResource,
        "headers": _HEADERS,
        "content": MESH_CONTENT,
    },
    202: {"description": "The mesh waits or runs; see Location.", "model": SequenceResource, "headers": _HEADERS},
}


@router.post(
    "",
    summary="Begin a sequence",
    operation_id="createSequence",
    status_code=201,
    response_model=None,
    responses={**_ANSWERS, **problems(400, 406, 408, 409, 413, 415, 422, 429, 503, 507)},
    openapi_extra={"requestBody": MESH_BODY},
)
async def create(
    request: Request,
    service: ServiceDependency,
    caller: Writer,
    format: Format = None,
    prefer: Prefer = None,
    idempotency_key: IdempotencyKey = None,
    keep: Annotated[int, Query(ge=2, le=1000, description=_KEEP)] = 2,
) -> Response:
    """Begin with a first mesh. The body is the spec of a mesh with a grid.

    The answer names the sequence, and waits for the first mesh as a request for a mesh does.
    """
    waiting = Waiting.of(request, service, format, prefer)
    key = check_key(idempotency_key)
    admitted = await receive_mesh(request, service, caller)
    from equimesh_service.admission.steps import check_first_spec  # which needs the solver, as that check did

    admitted = check_first_spec(admitted)
    step = NewStep(
        sequence_id=f"q-{secrets.token_hex(10)}",
        number=0,
        keep=keep,
        fingerprint=sha256(f"sequence {keep} {admitted.fingerprint(waiting.format)}".encode()).hexdigest(),
        key_id=caller.key_id,
    )
    with service.quotas.count_wait(caller, waiting.seconds):
        mesh_request = MeshRequest(format=waiting.format, seconds=waiting.seconds, key=key, step=step)
        accepted = await service.intake.accept(admitted, caller, mesh_request)
        return await _answer(waiting, request, service, caller, accepted)


class _Page(BaseModel):
    """The sequences that a page lists."""

    limit: int = Field(50, ge=1, le=200, description="Most sequences on a page.")
    cursor: str | None = Field(None, description="`next_cursor` of the page before.")


@router.get("", summary="List sequences, newest first", operation_id="listSequences", responses=problems(422))
async def list_sequences(
    request: Request, response: Response, service: ServiceDependency, caller: Reader, page: Annotated[_Page, Query()]
) -> SequenceList:
    """A page of sequences at their current steps; the header `Link` with rel="next" leads to the next one."""
    before = None if page.cursor is None else moment_of(page.cursor)
    find = partial(service.store.sequences.page, key_id=caller.only, before=before, limit=page.limit + 1)
    rows = await run_in_threadpool(find)
    following = None
    if len(rows) > page.limit:
        last = rows[page.limit - 1]
        following = cursor_at(last.created_at, last.id)
        url = request.url.include_query_params(cursor=following)
        response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
    shown = rows[: page.limit]
    meshes = await run_in_threadpool(service.store.meshes.several, [row.mesh_id for row in shown])
    items = [
        sequence_resource(row, row.number, meshes[row.mesh_id], service.settings.root)
        for row in shown
        if row.mesh_id in meshes  # it may have been deleted in between
    ]
    return SequenceList(items=items, next_cursor=following)


@router.get("/{id}", summary="Look at a sequence", operation_id="getSequence", responses=problems(404, 410))
async def get(id: str, service: ServiceDependency, caller: Reader) -> SequenceResource:
    """The sequence at its last step that has not failed, with the mesh of that step."""
    row = await service.sequence(id, caller)
    mesh = await service.mesh(row.mesh_id, caller)
    return sequence_resource(row, row.number, mesh, service.settings.root, await _velocity(service, mesh))


@router.post(
    "/{id}/steps",
    summary="Take a step",
    operation_id="createStep",
    status_code=201,
    response_model=None,
    responses={**_ANSWERS, **problems(400, 404, 406, 408, 409, 410, 413, 415, 422, 429, 503, 507)},
    openapi_extra={"requestBody": _STEP_BODY},
)
async def step(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Writer,
    format: Format = None,
    prefer: Prefer = None,
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """The next mesh, for u at the nodes of the current mesh or as an expression, and the fields carried to it.

    `step` is the step that this one follows; if another step already follows it, the answer is 409. A failed step does
    not count: another can be requested in its place. With `?format=npz` the file of the mesh has u, the fields, the
    `velocity` of its nodes since the step before, and in `step_json` the bytes of status, certificate and warnings.
    """
    sequence = await service.sequence(id, caller)
    if sequence.key_id not in ("", caller.key_id):  # the key of the sequence would not see the mesh of the step
        raise Problem("forbidden", "Only the key that began a sequence takes its steps.")
    waiting = Waiting.of(request, service, format, prefer)
    key = check_key(idempotency_key)
    with ExitStack() as stack:
        with service.bodies.place(caller.key_id) as place:
            kind, data = await _read_body(request, service, place)
            stopwatch.lap("receive")
            head = f"{id} {waiting.format} {kind} "
            fingerprint, again = "", None  # which a request without a key does not need
            if key is not None:
                with refusals():
                    fingerprint, again = await run_in_threadpool(_find_repeated, service, caller, key, head, data)
            if again is not None:
                with service.quotas.count_wait(caller, waiting.seconds):
                    return await _answer(waiting, request, service, caller, AcceptedMesh(again))
            await service.quotas.check_bytes(caller, len(data))
            at = StepPlace(
                sequence_id=id,
                number=sequence.number,
                mesh_id=sequence.mesh_id,
                points=sequence.points,
                keep=sequence.keep,
                fingerprint=fingerprint,
            )
            mesh_request = MeshRequest(format=waiting.format, seconds=waiting.seconds, key=key)
            if sequence.status == SUCCEEDED and _is_short(kind, data, at.points):
                with service.quotas.count_wait(caller, waiting.seconds):
                    body = Body(content_type=kind, content=data, caller=caller)
                    taken = await service.intake.take_step(body, mesh_request, at)
                    if taken is not None:
                        del body, data
                        return await _answer(waiting, request, service, caller, taken, (id, at.number + 1))
            move, made = await service.check(_check_step, service, (kind, data), sequence, caller, stack)
            del data  # a mesh that is waited for needs it no more
        if made is None:
            start = await _start(service, caller, sequence.id, move.step)
            made = await service.check(_prepare_step, service, move, start, caller, stack)
        stopwatch.lap("check")
        step = made.new_step(replace(at, number=move.step), caller.key_id)
        new = replace(step, discard=service.discard)
        with service.quotas.count_wait(caller, waiting.seconds):
            accepted = await service.intake.accept(made.admitted, caller, replace(mesh_request, step=new))
            return await _answer(waiting, request, service, caller, accepted, (id, new.number))


@router.delete(
    "/{id}", summary="Delete a sequence", operation_id="deleteSequence", status_code=204, responses=problems(404, 410)
)
async def delete(id: str, service: ServiceDependency, caller: Writer) -> None:
    """Delete the sequence and its meshes; an unfinished mesh is canceled first."""
    await service.sequence(id, caller)
    meshes = await run_in_threadpool(service.store.sequences.meshes, id)
    for mesh_id in meshes:
        if await run_in_threadpool(service.store.queue.cancel, mesh_id):
            service.metrics.count_end(Ending(status=CANCELED))
    if not await run_in_threadpool(service.store.sequences.delete, id, service.discard):
        raise Problem("not-found", "There is no sequence with this id.")
    for mesh_id in meshes:
        service.dispatcher.cancel(mesh_id)


async def _velocity(service: Service, mesh: MeshRow) -> Any:
    """The displacement of the nodes of a step as lists; None where there is none, or where it is long."""
    if mesh.status != SUCCEEDED or mesh.n_xi * mesh.n_eta > _MAX_VELOCITY_POINTS:
        return None
    artifact = await run_in_threadpool(service.store.meshes.artifact, mesh.id, "mesh")
    if artifact is None:
        return None

    def read() -> Any:
        with service.files.opened(artifact.sha256) as stream:
            return _read_velocity(stream)

    try:
        return await run_in_threadpool(read)
    except FileNotFoundError:  # the mesh was deleted in between
        return None


def _read_velocity(stream: BinaryIO) -> list[list[list[float]]] | None:
    """The displacement of the nodes in the npz file of a step; None for another mesh. Blocks have rows of one node."""
    with np.load(stream, allow_pickle=False) as file:
        name = json.loads(file[ANSWER].tobytes())["velocity"] if ANSWER in file.files else None
        if name is None:
            return None
        moves = file[name]
    found: list[list[list[float]]] = (moves if moves.ndim == 3 else moves[:, None]).tolist()
    return found


def _read_step(service: Service, kind: str, data: bytes, points: int) -> "Move":
    """The step in a body; raises 400, 413 and 422 problems."""
    admission = service.checks.admission
    from equimesh_service.admission import steps

    if kind == bodies.NPZ:
        return steps.read_arrays(data, steps.max_bytes(service.settings, points))
    return steps.read_long_json(admission, data, points)


def _check_step(
    service: Service, body: tuple[str, bytes], at: SequenceRow, caller: Caller, stack: ExitStack
) -> "tuple[Move, PreparedStep | None]":
    """The step in a body, prepared where it follows the mesh that the sequence is at; raises 4xx problems.

    Where another step is taken meanwhile, the store refuses this one.
    """
    move = _read_step(service, *body, at.points)  # all meshes of a sequence have as many points
    is_usual = move.step == at.number and at.status == SUCCEEDED
    return move, _prepare_step(service, move, at.mesh_id, caller, stack) if is_usual else None


def _prepare_step(service: Service, move: "Move", start: str, caller: Caller, stack: ExitStack) -> "PreparedStep":
    """The step after the mesh ``start``; raises 409 and 422 problems."""
    from equimesh_service.admission.steps import StepAdmission

    return StepAdmission(service.checks.admission, service.store, service.files).prepare(move, start, caller, stack)


async def _read_body(request: Request, service: Service, place: bodies.BodyPlace) -> tuple[str, bytes]:
    """The media type and the bytes of a step."""
    kind = bodies.media_type(request)
    if kind not in (bodies.JSON, bodies.NPZ):
        shown = repr(kind[:80]) if kind else "no Content-Type"
        raise Problem("unsupported-media-type", f"Send {bodies.JSON} or {bodies.NPZ}, not {shown}.")
    return kind, await bodies.read_body(request, service.settings.max_body, place)


def _is_short(kind: str, data: bytes, points: int) -> bool:
    """Whether a step goes to a worker as it came: its text is read at once, and all its files become rows."""
    return points <= MAX_STEP_POINTS and len(data) <= (MAX_ROW_BYTES if kind == bodies.NPZ else _MAX_TEXT_BYTES)


def _find_repeated(service: Service, caller: Caller, key: str, head: str, data: bytes) -> tuple[str, str | None]:
    """What is equal for equal requests of a step, and the mesh of an earlier one with this idempotency key."""
    digest = sha256(head.encode())
    digest.update(data)
    fingerprint = digest.hexdigest()
    return fingerprint, service.store.meshes.find_repeated(caller.key_id, key, fingerprint)


async def _start(service: Service, caller: Caller, sequence_id: str, step: int) -> str:
    """The id of the finished mesh that the next step follows; raises the problem why there is none."""
    sequence = await service.sequence(sequence_id, caller)
    number = step if 0 <= step < MAX_NUMBER else -1
    mesh_id = None
    if number == sequence.number or (number < sequence.number and sequence.status in (FAILED, CANCELED)):
        mesh_id = await run_in_threadpool(service.store.sequences.mesh_of, sequence_id, number)
    if mesh_id is None:
        detail = f"The sequence is at step {sequence.number}, not {step}: give u at the nodes of its current mesh."
        raise Problem("conflict", detail, remedy="GET the sequence for its step and its mesh.")
    check_done(await service.mesh(mesh_id, caller), partial=False)
    return mesh_id


async def _answer(
    waiting: Waiting,
    request: Request,
    service: Service,
    caller: Caller,
    accepted: AcceptedMesh,
    found: tuple[str, int] | None = None,
) -> Response:
    """The answer with the mesh, its file or its state, and with the sequence and the number that it is ``found`` at."""
    found = found or await run_in_threadpool(service.store.sequences.step_of, accepted.mesh_id)
    if found is None:
        raise Problem("conflict", "The sequence was deleted at this moment.")
    (sequence_id, number), root = found, service.settings.root
    location = f"{root}/v1/meshes/{accepted.mesh_id}" if number else f"{root}/v1/sequences/{sequence_id}"

    async def describe(row: MeshRow) -> SequenceResource:
        sequence = await service.sequence(sequence_id, caller)
        return sequence_resource(sequence, number, row, root, await _velocity(service, row))

    headers = {"Location": location, "Equimesh-Step": str(number)}
    return await waiting.answer(request, service, caller, accepted, headers, describe)
