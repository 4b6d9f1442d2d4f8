"""Steps of a mesh that follows a time-stepper, and the flows that request them; no I/O."""

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import BadArgument, DownloadDamaged
from equimesh_client.records.state import MeshState
from equimesh_client.records.tables import Array
from equimesh_client.spec.request import GenerateArguments
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.flows import LONG_POLL_SECONDS, Flow, hold_seconds
from equimesh_client.wire.outcome import raise_unless_succeeded
from equimesh_client.wire.protocol import Call, Reply


@dataclass(frozen=True, kw_only=True, eq=False)
class SequenceStep:
    """A step of a sequence: its ``number``, the id of its mesh, and the arrays of that mesh."""

    number: int
    mesh_id: str
    arrays: MeshArrays

    @property
    def x(self) -> Array:
        """The x coordinates, shape ``(n_xi, n_eta)``."""
        return self.arrays.x

    @property
    def y(self) -> Array:
        """The y coordinates, shape ``(n_xi, n_eta)``."""
        return self.arrays.y

    @property
    def u(self) -> Array:
        """u at the nodes, shape ``(n_xi, n_eta)``."""
        assert self.arrays.u is not None  # the monitor of a sequence has one
        return self.arrays.u

    @property
    def fields(self) -> Mapping[str, Array]:
        """The fields at the nodes of the mesh of the step."""
        return self.arrays.fields


class SequenceState:
    """The state of a sequence: its ``id`` and its last step ``current``, with the arrays of that mesh."""

    def __init__(self, record: Mapping[str, Any], current: SequenceStep) -> None:
        self.id = str(record["id"])
        self.current = current

    @property
    def x(self) -> Array:
        """The x coordinates of the current nodes, shape ``(n_xi, n_eta)``."""
        return self.current.x

    @property
    def y(self) -> Array:
        """The y coordinates of the current nodes, shape ``(n_xi, n_eta)``."""
        return self.current.y


def begin(
    arguments: GenerateArguments, keep: int, settings: Settings, deadline: Deadline
) -> Flow[tuple[dict[str, Any], SequenceStep]]:
    """The resource of a new sequence, and its first mesh."""
    mesh_request = yield from flows.prepare(arguments, settings, deadline)
    call = protocol.create_sequence(mesh_request, wait=hold_seconds(deadline), keep=keep)
    record = protocol.json_of((yield from flows.request(call, settings, deadline)))
    return record, (yield from _wait_for_step(record["mesh"], int(record["step"]), settings, deadline))


def look(sequence_id: str, settings: Settings, deadline: Deadline) -> Flow[tuple[dict[str, Any], SequenceStep]]:
    """The resource of a sequence, and its current mesh."""
    record = yield from flows.fetch(protocol.sequence(sequence_id), settings, deadline)
    return record, (yield from _wait_for_step(record["mesh"], int(record["step"]), settings, deadline))


def advance(call: Call, settings: Settings, deadline: Deadline) -> Flow[SequenceStep]:
    """The next step; raises :class:`MeshFailed` when it has no mesh."""
    call = replace(call, headers={**call.headers, "Prefer": f"wait={hold_seconds(deadline)}"})
    reply: Reply = yield from flows.persist(replace(call, patience=float(LONG_POLL_SECONDS)), settings, deadline)
    number, place = reply.headers.get("equimesh-step"), reply.headers.get("location", "")
    if number is None:
        protocol.raise_for_status(reply, call)
        raise DownloadDamaged(f"{call.path}: the answer names no step; the service may be too old for sequences")
    mesh_id = place.rpartition("/")[2]
    if reply.status == 201:
        sha256 = protocol.sha256_of(reply.headers)
        if sha256 is None or hashlib.sha256(reply.body).hexdigest() == sha256:
            return SequenceStep(number=int(number), mesh_id=mesh_id, arrays=arrays_of(reply.body))
    # The mesh failed, is not finished, or arrived damaged: its resource says which.
    record = yield from flows.fetch(protocol.get_mesh(mesh_id), settings, deadline)
    return (yield from _wait_for_step(record, int(number), settings, deadline))


def step_call(
    sequence_id: str,
    current: SequenceStep,
    u: object,
    fields: Mapping[str, npt.ArrayLike] | None,
    parameters: Mapping[str, float] | None,
    t: float | None,
) -> Call:
    """The request for the step after ``current``. Equal arguments give equal requests, which are safe to repeat."""
    carried = {name: np.asarray(values, dtype=np.float64) for name, values in (fields or {}).items()}
    if isinstance(u, str):
        source: dict[str, Any] = {"expression": u}
        source |= {"parameters": dict(parameters)} if parameters else {}
        source |= {"t": t} if t is not None else {}
        sent = {"step": current.number, "u": source, "fields": carried}
        return protocol.create_step(sequence_id, protocol.json_bytes(sent), "application/json", sent=sent)
    if parameters or t is not None:
        raise BadArgument("parameters and t belong to an expression; u is not a string here")
    if {"u", "step"} & set(carried):
        raise BadArgument("a field cannot be called u or step")
    values: Any = u(current.x, current.y) if callable(u) else u
    body = io.BytesIO()
    arrays: dict[str, Any] = {"step": np.int64(current.number), "u": np.asarray(values, dtype=np.float64), **carried}
    np.savez(body, **arrays)
    return protocol.create_step(sequence_id, body.getvalue(), "application/x-npz")


def _wait_for_step(
    record: Mapping[str, Any], number: int, settings: Settings, deadline: Deadline
) -> Flow[SequenceStep]:
    """The step of a mesh, once the mesh is finished."""
    now = yield from flows.wait(record, settings, deadline, watched=False)
    mesh = MeshState(now)
    raise_unless_succeeded(mesh)
    body = yield from flows.fetch_file(protocol.mesh_file(mesh.id, "npz"), settings, deadline)
    return SequenceStep(number=number, mesh_id=mesh.id, arrays=arrays_of(body))
