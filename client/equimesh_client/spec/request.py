"""A request for a mesh, made ready: what `generate` and `meshes.create` of both clients share."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import UNIT_BOX, Box, Domain, domain_json, read_domain
from equimesh_client.spec.mesh import mesh_spec
from equimesh_client.spec.monitors import ArcLength, Monitor, Read, monitor_json
from equimesh_client.spec.schwarz import Schwarz
from equimesh_client.spec.sources import StoredSamples, Upload, needs_box, source_of, upload_of

DEADLINE = 600.0
"""Seconds that a wait may take when the caller does not say."""
UPLOAD = "upload"


@dataclass(frozen=True, kw_only=True)
class Order:
    """One logical request for a mesh. ``uploads`` are the files that go with it, of which the spec speaks as
    ``{"samples": "upload"}``, or while there are several as ``"upload:0"``, ``"upload:1"`` and so on. ``key`` stays the
    same over all retries, so that one mesh comes of it. Without ``reuse`` the mesh is computed even if the service has
    the same one.
    """

    spec: dict[str, Any]
    uploads: tuple[Upload, ...]
    key: str
    reuse: bool = True

    def stored(self, names: Sequence[str]) -> Order:
        """The same order for samples that the service keeps under ``names``."""
        given = {f"upload:{number}": name for number, name in enumerate(names)}
        return replace(self, spec={**self.spec, "monitor": _renamed(self.spec["monitor"], given)}, uploads=())


@dataclass(frozen=True, kw_only=True)
class Wish:
    """What `generate` is asked for: its arguments."""

    u: object
    n: int | tuple[int, int]
    monitor: Monitor | Mapping[str, Any] | None
    domain: Domain | Mapping[str, Any] | None
    a: float
    b: float
    schwarz: Schwarz | Mapping[str, Any] | None
    boundary: str
    initial: str
    mode: str
    allow_relaxed: bool
    cells: str
    label: str | None
    parameters: Mapping[str, float] | None
    t: float | None
    n_samples: int
    reuse: bool

    def box(self) -> Box | None:
        """The box on which functions are sampled; None where only the service knows it, and it is needed."""
        functions: list[object] = []

        def look(function: object) -> dict[str, Any]:
            functions.append(function)
            return {}

        self._monitor(look)
        if self.domain is None or not any(map(needs_box, functions)):
            return UNIT_BOX
        domain = read_domain(self.domain) if isinstance(self.domain, Mapping) else self.domain
        return domain.box

    def order(self, box: Box) -> Order:
        """The request, with callables and arrays sampled on ``box``."""
        uploads: list[Upload] = []
        formulas = 0

        def read(function: object) -> dict[str, Any]:
            nonlocal formulas
            is_formula = isinstance(function, str)
            formulas += is_formula
            more = {"parameters": self.parameters, "t": self.t} if is_formula else {}
            source = source_of(function, n_samples=self.n_samples, box=box, **more)  # type: ignore[arg-type]
            if source.upload is None:
                return source.json
            if source.upload not in uploads:
                uploads.append(source.upload)
            return {"samples": f"upload:{uploads.index(source.upload)}"}

        monitor = self._monitor(read)
        if not formulas and (self.parameters or self.t is not None):
            raise BadArgument("parameters and t belong to an expression; u is not a string here")
        if len(uploads) == 1:
            monitor = _renamed(monitor, {"upload:0": UPLOAD})
        spec = mesh_spec(
            monitor,
            self.n,
            domain=None if self.domain is None else domain_json(self.domain),
            schwarz=self.schwarz,
            boundary=self.boundary,
            initial=self.initial,
            mode=self.mode,
            allow_relaxed=self.allow_relaxed,
            cells=self.cells,
            label=self.label,
        )
        return Order(spec=spec, uploads=tuple(uploads), key=str(uuid.uuid4()), reuse=self.reuse)

    def _monitor(self, read: Read) -> dict[str, Any]:
        if self.monitor is None:
            return monitor_json(ArcLength(a=self.a, b=self.b), read, self.u)
        if (self.a, self.b) != (ArcLength.a, ArcLength.b):
            raise BadArgument("a and b belong to the arc length: give them in it, monitor=ArcLength(a=..., b=...)")
        return monitor_json(self.monitor, read, self.u)


def order_of_spec(spec: Mapping[str, Any], samples: object, key: str | None, *, reuse: bool = True) -> Order:
    """The request for a complete spec; ``samples`` go with ``{"samples": "upload"}`` in its monitor.

    Raises :class:`BadArgument` when one of the two is missing.
    """
    if not isinstance(spec, Mapping):
        raise BadArgument(f"a spec is a mapping, as in the HTTP interface, not {type(spec).__name__}")
    if _wants_upload(spec.get("monitor")) != (samples is not None):
        raise BadArgument('samples go with a spec whose monitor has "u": {"samples": "upload"}, and only with it')
    uploads = () if samples is None else (upload_of(samples),)
    return Order(spec=dict(spec), uploads=uploads, key=key or str(uuid.uuid4()), reuse=reuse)


def _wants_upload(monitor: object) -> bool:
    if not isinstance(monitor, Mapping):
        return False
    members = monitor.get("monitors")
    inner = any(map(_wants_upload, members)) if isinstance(members, Sequence) else False
    return inner or any(isinstance(part, Mapping) and part.get("samples") == UPLOAD for part in monitor.values())


def _renamed(monitor: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """The JSON of a monitor with other names for samples."""
    made: dict[str, Any] = {}
    for key, part in monitor.items():
        if key == "monitors":
            made[key] = [_renamed(member, names) for member in part]
        elif isinstance(part, Mapping) and part.get("samples") in names:
            made[key] = {"samples": names[part["samples"]]}
        else:
            made[key] = part
    return made


def stored(record: Mapping[str, Any]) -> StoredSamples:
    """Samples that the service keeps."""
    return StoredSamples(id=str(record["id"]), record=dict(record))
