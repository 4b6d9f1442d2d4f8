"""A complete request for a mesh, for `generate` and `meshes.create` of both clients."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import UNIT_BOX, Box, Domain, box_around
from equimesh_client.spec.mesh import MeshOptions, mesh_spec
from equimesh_client.spec.monitors import Json, Read, monitor_json
from equimesh_client.spec.sources import Upload, needs_box, source_of, upload_of
from equimesh_schema import ArcLength, Auto

UPLOAD = "upload"
"""Name in a spec of the one file of samples that is sent with the request."""


@dataclass(frozen=True, kw_only=True)
class MeshRequest:
    """One logical request for a mesh.

    ``uploads`` are its files of samples. The spec refers to a single one as ``{"samples": "upload"}``, and to several
    as ``"upload:0"``, ``"upload:1"`` and so on. ``mesh`` is the file of its domain. ``key`` is the same in all retries,
    which therefore give one mesh. Without ``reuse`` the mesh is computed even if the service has an equal one.
    """

    spec: dict[str, Any]
    uploads: tuple[Upload, ...]
    key: str
    reuse: bool = True
    mesh: Upload | None = None

    def with_stored_samples(self, ids: Sequence[str]) -> MeshRequest:
        """The same request, with stored samples of these ``ids`` in place of its uploads."""
        names = {f"upload:{number}": samples_id for number, samples_id in enumerate(ids)}
        names |= {UPLOAD: ids[0]} if len(ids) == 1 else {}
        return replace(self, spec={**self.spec, "monitor": _rename_samples(self.spec["monitor"], names)}, uploads=())


@dataclass(frozen=True, kw_only=True)
class GenerateArguments:
    """The arguments of `generate`; ``options`` holds all options of a mesh, as `complete_options` returns them."""

    u: object
    n: int | tuple[int, int]
    options: MeshOptions
    initial: str = "nested"
    cells: str = "quad"
    reuse: bool = True

    def box(self) -> Box | None:
        """The box on which functions are sampled; None where it is needed and only the service knows it."""
        functions: list[object] = []

        def collect(function: object) -> dict[str, Any]:
            functions.append(function)
            return {}

        self._monitor_json(collect)
        domain = self.options["domain"]
        if domain is None or not any(map(needs_box, functions)):
            return UNIT_BOX
        return box_around(domain)

    def on(self, domain: Domain | Mapping[str, Any] | None) -> GenerateArguments:
        """The same arguments with another domain."""
        return replace(self, options={**self.options, "domain": domain})

    def request(self, box: Box) -> MeshRequest:
        """The request, with callables and arrays sampled on ``box``."""
        uploads: list[Upload] = []
        has_formula = False
        parameters, t, n_samples = self.options["parameters"], self.options["t"], self.options["n_samples"]

        def read(function: object) -> dict[str, Any]:
            nonlocal has_formula
            if isinstance(function, str):
                has_formula = True
                return source_of(function, parameters=parameters, t=t).json
            source = source_of(function, n_samples=n_samples, box=box)
            if source.upload is None:
                return source.json
            if source.upload not in uploads:
                uploads.append(source.upload)
            return {"samples": f"upload:{uploads.index(source.upload)}"}

        monitor = self._monitor_json(read)
        if not has_formula and (parameters or t is not None):
            raise BadArgument("parameters and t belong to an expression; u is not a string here")
        if len(uploads) == 1:
            monitor = _rename_samples(monitor, {"upload:0": UPLOAD})
        spec = mesh_spec(monitor, self.n, self.options, initial=self.initial, cells=self.cells)
        return MeshRequest(spec=spec, uploads=tuple(uploads), key=str(uuid.uuid4()), reuse=self.reuse)

    def _monitor_json(self, read: Read) -> Json:
        monitor, a, b = self.options["monitor"], self.options["a"], self.options["b"]
        if monitor is None and a is None and b is None:  # the service's default, which earlier services have, too
            return {"u": monitor_json(Auto(), read, self.u)["u"]}
        if monitor is None:
            arc_length = ArcLength(a=ArcLength.a if a is None else a, b=ArcLength.b if b is None else b)
            return monitor_json(arc_length, read, self.u)
        if a is not None or b is not None:
            raise BadArgument("a and b belong to the arc length: give them in it, monitor=ArcLength(a=..., b=...)")
        return monitor_json(monitor, read, self.u)


def request_of_spec(spec: Mapping[str, Any], samples: object, key: str | None, *, reuse: bool = True) -> MeshRequest:
    """The request for a complete spec; ``samples`` belong to ``{"samples": "upload"}`` in its monitor.

    Raises :class:`BadArgument` for one without the other.
    """
    if not isinstance(spec, Mapping):
        raise BadArgument(f"a spec is a mapping, as in the HTTP interface, not {type(spec).__name__}")
    if _needs_upload(spec.get("monitor")) != (samples is not None):
        raise BadArgument('samples go with a spec whose monitor has "u": {"samples": "upload"}, and only with it')
    uploads = () if samples is None else (upload_of(samples),)
    if any(upload.column for upload in uploads):
        raise BadArgument("a file of which a column is u is stored first: client.samples.upload(SampleFile(...))")
    return MeshRequest(spec=dict(spec), uploads=uploads, key=key or str(uuid.uuid4()), reuse=reuse)


def _needs_upload(monitor: object) -> bool:
    if not isinstance(monitor, Mapping):
        return False
    members = monitor.get("monitors")
    inner = any(map(_needs_upload, members)) if isinstance(members, Sequence) else False
    return inner or any(isinstance(part, Mapping) and part.get("samples") == UPLOAD for part in monitor.values())


def _rename_samples(monitor: Mapping[str, Any], names: Mapping[str, str]) -> Json:
    """The JSON of a monitor, with the names of samples replaced."""
    renamed: Json = {}
    for key, part in monitor.items():
        if key == "monitors":
            renamed[key] = [_rename_samples(member, names) for member in part]
        elif isinstance(part, Mapping) and part.get("samples") in names:
            renamed[key] = {"samples": names[part["samples"]]}
        else:
            renamed[key] = part
    return renamed
