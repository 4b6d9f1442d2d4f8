"""Meshes that follow a time-stepper: what a step is, and how one is asked for; no I/O."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import BadArgument, DownloadDamaged
from equimesh_client.records.state import MeshState
from equimesh_client.records.tables import Array
from equimesh_client.spec.request import Order, Wish
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.flows import LONG_POLL, Flow
from equimesh_client.wire.outcome import settled
from equimesh_client.wire.protocol import Call, Reply

U: TypeAlias = "str | npt.ArrayLike | Callable[[Array, Array], npt.ArrayLike]"


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A step of a sequence: its ``number``, the id of its mesh, and the mesh itself with all that was carried to it."""

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
        """The fields that the step came with, at the nodes of its own mesh."""
        return self.arrays.fields


def begin(wish: Wish, keep: int, settings: Settings, deadline: Deadline) -> Flow[tuple[dict[str, Any], Step]]:
    """The resource of a new sequence, and its first mesh."""
    made: Order = yield from flows.prepared(wish, settings, deadline)
    upload = made.uploads[0] if made.uploads else None
    wait = _patience(deadline)
    call = protocol.create_sequence(made.spec, upload, wait=wait, key=made.key, keep=keep)
    record = protocol.json_of((yield from flows.request(call, settings, deadline)))
    return record, (yield from _finished(record["mesh"], int(record["step"]), settings, deadline))


def look(sequence_id: str, settings: Settings, deadline: Deadline) -> Flow[tuple[dict[str, Any], Step]]:
    """The resource of a sequence, and its current mesh."""
    record = yield from flows.fetch(protocol.sequence(sequence_id), settings, deadline)
    return record, (yield from _finished(record["mesh"], int(record["step"]), settings, deadline))


def advance(call: Call, settings: Settings, deadline: Deadline) -> Flow[Step]:
    """The next step; raises :class:`MeshFailed` when it has no mesh."""
    call = replace(call, headers={**call.headers, "Prefer": f"wait={_patience(deadline)}"})
    reply: Reply = yield from flows.persist(replace(call, patience=float(LONG_POLL)), settings, deadline)
    number, place = reply.headers.get("equimesh-step"), reply.headers.get("location", "")
    if number is None:
        protocol.checked(reply, call)
        raise DownloadDamaged(f"{call.path}: the answer names no step; the service may be too old for sequences")
    mesh_id = place.rpartition("/")[2]
    if reply.status == 201:
        sha256 = protocol.sha256_of(reply.headers)
        if sha256 is None or hashlib.sha256(reply.body).hexdigest() == sha256:
            return Step(number=int(number), mesh_id=mesh_id, arrays=arrays_of(reply.body))
    # It failed, is not finished, or came damaged: the mesh tells.
    record = yield from flows.fetch(protocol.get_mesh(mesh_id), settings, deadline)
    return (yield from _finished(record, int(number), settings, deadline))


def step_call(
    sequence_id: str,
    current: Step,
    u: object,
    fields: Mapping[str, npt.ArrayLike] | None,
    parameters: Mapping[str, float] | None,
    t: float | None,
) -> Call:
    """The request for the step after ``current``. The same content is the same request, however often it is sent."""
    given = {name: np.asarray(values, dtype=np.float64) for name, values in (fields or {}).items()}
    if isinstance(u, str):
        source: dict[str, Any] = {"expression": u}
        source |= {"parameters": dict(parameters)} if parameters else {}
        source |= {"t": t} if t is not None else {}
        sent = {"step": current.number, "u": source, "fields": given}
        return protocol.create_step(sequence_id, protocol.encoded(sent), "application/json", sent=sent)
    if parameters or t is not None:
        raise BadArgument("parameters and t belong to an expression; u is not a string here")
    if {"u", "step"} & set(given):
        raise BadArgument("a field cannot be called u or step")
    values: Any = u(current.x, current.y) if callable(u) else u
    body = io.BytesIO()
    arrays: dict[str, Any] = {"step": np.int64(current.number), "u": np.asarray(values, dtype=np.float64), **given}
    np.savez(body, **arrays)
    return protocol.create_step(sequence_id, body.getvalue(), "application/x-npz")


def _patience(deadline: Deadline) -> int:
    return max(1, min(LONG_POLL, int(deadline.left)))


def _finished(record: Mapping[str, Any], number: int, settings: Settings, deadline: Deadline) -> Flow[Step]:
    """A step whose mesh may still have to be waited for."""
    now = yield from flows.wait(record, settings, deadline, watched=False)
    mesh = MeshState(now)
    settled(mesh)
    body = yield from flows.verified(protocol.mesh_file(mesh.id, "npz"), settings, deadline)
    return Step(number=number, mesh_id=mesh.id, arrays=arrays_of(body))
