"""Steps of a mesh that follows a time-stepper, and the flows that request them; no I/O."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from equimesh_client.errors import BadArgument, DownloadDamaged
from equimesh_client.records.measures import Array
from equimesh_client.records.resources import MeshState
from equimesh_client.spec.fields import Motion, motion_json, number_array, read_fields
from equimesh_client.spec.request import GenerateArguments, Later, monitor_json
from equimesh_client.spec.sources import StoredSamples, source_of
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.arrays import MeshArrays, arrays_of, raise_unless_succeeded
from equimesh_client.wire.flows import LONG_POLL_SECONDS, Flow, hold_seconds
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.settings import Deadline, Settings
from equimesh_coupling.display import facts_of, picture
from equimesh_coupling.values import is_field
from equimesh_schema import Certificate
from equimesh_schema.monitors import AnyMonitor as Monitor
from equimesh_schema.notebook import html_of


@dataclass(frozen=True, kw_only=True, eq=False)
class SequenceStep:
    """A step of a sequence: its ``number``, the id of its mesh, and the arrays of that mesh.

    ``status`` is that of the mesh, as :attr:`Mesh.status`, and ``certificate`` how well it solves the requested
    equations, None where the service is of a release that does not say so.
    """

    number: int
    mesh_id: str
    arrays: MeshArrays
    status: str = "succeeded"
    certificate: Certificate | None = None

    @classmethod
    def of(cls, number: int, mesh_id: str, arrays: MeshArrays, record: Mapping[str, Any] | None = None) -> SequenceStep:
        """The step whose mesh has these arrays; what they do not say is in the ``record`` of the mesh."""
        said = arrays.step or record or {}
        certificate = said.get("certificate")
        return cls(
            number=number,
            mesh_id=mesh_id,
            arrays=arrays,
            status=str(said.get("status") or "succeeded"),
            certificate=Certificate.from_json(certificate) if isinstance(certificate, dict) else None,
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw the mesh on ``axes`` of matplotlib, or on those of pyplot, and return the axes."""
        return self.arrays.plot(axes)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        facts = [("step", str(self.number)), ("mesh", self.mesh_id), ("status", self.status)]
        facts += facts_of(self.arrays.mesh_parts())
        if self.arrays.fields:
            facts.append(("fields", ", ".join(self.arrays.fields)))
        title = "A step of a sequence" if self.certificate is None else self.certificate.headline
        return html_of(title, facts, self.warnings, picture(self.arrays), "the mesh of the step")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user of the mesh, in sentences; empty without any."""
        return () if self.certificate is None else self.certificate.warnings

    @property
    def substeps(self) -> int | None:
        """How many meshes were computed on the way to this one, itself included; None for the first mesh."""
        found = self.arrays.step.get("substeps")
        return None if found is None else int(found)

    @property
    def moved(self) -> float | None:
        """How far 95 % of the nodes have moved at most, in cells of the mesh before; None for the first mesh."""
        found = self.arrays.step.get("moved")
        return None if found is None else float(found)

    @property
    def velocity(self) -> Array | None:
        """How far the nodes have moved since the step before, shape ``(n_xi, n_eta, 2)``, on blocks ``(n, 2)``.

        None for the first mesh.
        """
        return self.arrays.velocity

    @property
    def x(self) -> Array:
        """The x coordinates, shape ``(n_xi, n_eta)``, on blocks ``(n,)``."""
        return self.arrays.x

    @property
    def y(self) -> Array:
        """The y coordinates, of the same shape."""
        return self.arrays.y

    @property
    def u(self) -> Array:
        """u at the nodes, of the same shape; raises :class:`BadArgument` where the monitor has none."""
        if self.arrays.u is None:
            raise BadArgument("the monitor of this step has no u: its functions and fields are in step.fields")
        return self.arrays.u

    @property
    def fields(self) -> Mapping[str, Array]:
        """The fields on the mesh of the step, at its nodes or in its cells."""
        return self.arrays.fields


class SequenceState:
    """The state of a sequence: its ``id`` and its last step ``current``, with the arrays of that mesh."""

    def __init__(self, record: Mapping[str, Any], current: SequenceStep) -> None:
        self.id = str(record["id"])
        self.current = current

    @property
    def x(self) -> Array:
        """The x coordinates of the current nodes, shape ``(n_xi, n_eta)``, on blocks ``(n,)``."""
        return self.current.x

    @property
    def y(self) -> Array:
        """The y coordinates of the current nodes, of the same shape."""
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
            return SequenceStep.of(int(number), mesh_id, arrays_of(reply.body))
    # The mesh failed, is not finished, or arrived damaged: its resource says which.
    record = yield from flows.fetch(protocol.get_mesh(mesh_id), settings, deadline)
    return (yield from _wait_for_step(record, int(number), settings, deadline))


@dataclass(frozen=True, kw_only=True, eq=False)
class StepArguments:
    """The arguments of a step, as :meth:`Sequence.step` takes them."""

    u: object = None
    fields: Mapping[str, object] | None = None
    monitor: Monitor | Mapping[str, Any] | None = None
    parameters: Mapping[str, float] | None = None
    t: float | None = None
    motion: Motion = field(default_factory=lambda: Motion())


def step_call(sequence_id: str, current: SequenceStep, given: StepArguments) -> Call:
    """The request for the step after ``current``. Equal arguments give equal requests, which are safe to repeat."""
    u, monitor, parameters, t = given.u, given.monitor, given.parameters, given.t
    carried, settings = read_fields(given.fields, current.arrays)
    motion = motion_json(given.motion)
    values: dict[str, Array] = {}
    formulas = 0

    def read(function: object) -> dict[str, Any]:
        nonlocal formulas
        if isinstance(function, str):
            formulas += 1
            return source_of(function, parameters=parameters, t=t).json
        if isinstance(function, StoredSamples):
            return {"samples": function.id}
        if isinstance(function, Mapping):
            return dict(function)
        name = f"monitor.{len(values)}"  # no field can have this name
        values[name] = _at_nodes(function, current, "a function of the monitor")
        return {"nodes": name}

    written = None if monitor is None else monitor_json(monitor, read, Later.U)
    source = read(u) if isinstance(u, str | Mapping) else None
    if not formulas and (parameters or t is not None):
        raise BadArgument("parameters and t belong to an expression; u is not a string here")
    if u is None and monitor is None:
        raise BadArgument("a step needs u, or a monitor")
    if isinstance(u, str) and current.x.ndim == 2:  # values on blocks are sent as arrays
        shown = {name: {"values": carried[name], **more} for name, more in settings.items()}
        sent: dict[str, Any] = {"step": current.number, "u": source, "fields": {**carried, **shown}, **motion}
        sent |= {} if written is None else {"monitor": _with_values(written, values)}
        return protocol.create_step(sequence_id, protocol.json_bytes(sent), "application/json", sent=sent)
    if {"u", "step"} & set(carried):
        raise BadArgument("a field cannot be called u or step")
    said = {"u": source, "monitor": written, "fields": settings}
    said = {key: value for key, value in said.items() if value} | motion
    arrays: dict[str, Any] = {"step": np.int64(current.number)}
    arrays |= {} if u is None or source is not None else {"u": _at_nodes(u, current, "u")}
    arrays |= {**carried, **values}
    arrays |= {"settings": protocol.json_bytes(said)} if said else {}
    body = io.BytesIO()
    np.savez(body, **arrays)
    return protocol.create_step(sequence_id, body.getvalue(), "application/x-npz", sent=said)


def _at_nodes(function: object, current: SequenceStep, name: str) -> Array:
    """The values of a callable at the nodes, or the values that are given."""
    is_formula = callable(function) and not is_field(function)
    return number_array(name, function(current.x, current.y) if is_formula else function, current.arrays)  # type: ignore[operator]


def _with_values(part: Any, values: Mapping[str, Array]) -> Any:
    """The JSON of a monitor with values in place of their names."""
    if isinstance(part, Mapping):
        if isinstance(part.get("nodes"), str):
            return {"nodes": values[part["nodes"]]}
        return {key: _with_values(member, values) for key, member in part.items()}
    return [_with_values(member, values) for member in part] if isinstance(part, list) else part


def _wait_for_step(
    record: Mapping[str, Any], number: int, settings: Settings, deadline: Deadline
) -> Flow[SequenceStep]:
    """The step of a mesh, once the mesh is finished."""
    now = yield from flows.wait(record, settings, deadline, watched=False)
    mesh = MeshState(now)
    raise_unless_succeeded(mesh)
    body = yield from flows.fetch_file(protocol.mesh_file(mesh.id, "npz"), settings, deadline)
    return SequenceStep.of(number, mesh.id, arrays_of(body), mesh.record)
