"""The spec of a mesh, its options, and the complete request for it."""

from __future__ import annotations

import inspect
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from enum import Enum
from typing import Any, Literal, TypeAlias, TypedDict

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import Domain, Json, box_around, domain_json, has_own_points
from equimesh_client.spec.sources import Upload, needs_box, source_of, upload_of
from equimesh_coupling.samples import UNIT_BOX, Box
from equimesh_schema.document import keys_of, without_usual
from equimesh_schema.mesh import Grid, MeshSpec, Target
from equimesh_schema.monitors import (
    FUNCTIONS,
    MONITORS,
    ArcLength,
    Auto,
    Curvature,
    Intersection,
    MonitorDocument,
    PlainMonitor,
)
from equimesh_schema.monitors import AnyMonitor as Monitor
from equimesh_schema.schwarz import TRANSMISSIONS, Condition, Schwarz
from equimesh_schema.sources import functions_of

# Monitors as JSON: their functions are read, and the u of a request gets its place.

Read: TypeAlias = Callable[[object], Json]
"""Returns the JSON of a function: an expression, arrays, a callable, a file or stored samples."""


class Later(Enum):
    """Stands for a u that a step of a sequence gives, or that of the step before: monitors without one leave it out."""

    U = "u"


def monitor_json(monitor: Monitor | Mapping[str, Any], read: Read, u: object) -> Json:
    """The JSON of a monitor. A mapping is such JSON already; ``u`` is added where it has none, unless it comes later.

    Raises :class:`BadArgument` for another object, and for a u that is missing or given twice.
    """
    if isinstance(monitor, Intersection):
        return _settings(monitor, {"monitors": _members(monitor, read, u)})
    if isinstance(monitor, MonitorDocument):
        return _of_fields(monitor, read, u)
    return _member(monitor, read, u)


def _member(monitor: object, read: Read, u: object) -> Json:
    if isinstance(monitor, Mapping):
        if u is Later.U:
            return _read_arrays(monitor, read)
        if u is not None and "u" in monitor:
            raise BadArgument("u is given twice: alone, and in the monitor")
        return {**monitor, **({} if u is None else {"u": read(u)})}
    if isinstance(monitor, PlainMonitor):
        return _of_fields(monitor, read, u)
    raise BadArgument(
        "a monitor is an ArcLength, Curvature, Weight or Tensor, or at the top an Auto, a LeastError, a"
        f" NodalSolution or an Intersection, of equimesh_client; not {monitor!r:.80}"
    )


def _members(monitor: Intersection, read: Read, u: object) -> list[Json]:
    """The JSON of the members of an intersection; those that lack a u take that of the request."""
    if not isinstance(monitor.monitors, Sequence):
        raise BadArgument("an Intersection takes a list of monitors")
    members: list[Json] = []
    is_used = False  # the first u is the function for the interpolation error
    for member in monitor.monitors:
        needs_u = isinstance(member, ArcLength | Curvature) and member.u is None
        members.append(_member(member, read, u if needs_u else None))
        is_used = is_used or needs_u
    if u is not None and u is not Later.U and not is_used:
        if not members or "u" in members[0]:
            raise BadArgument("u is not used: the first monitor of the intersection has its own u")
        members[0]["u"] = read(u)
    return members


def _of_fields(monitor: MonitorDocument, read: Read, u: object) -> Json:
    """The JSON of a monitor by its fields."""
    found: Json = {}
    for name in functions_of(type(monitor)):
        if name == "u":
            found |= _u_json(read, monitor, u)
        elif getattr(monitor, name) is not None:
            found[name] = read(getattr(monitor, name))
    return _settings(monitor, found)


def _settings(monitor: MonitorDocument, found: Json) -> Json:
    """The JSON of a monitor from what is ``found``; some keys are left out, for services that do not know them."""
    functions = functions_of(type(monitor))
    values: dict[str, Any] = {name: found.get(name) for name in (*functions, *found)}
    plain = without_usual(replace(monitor, **values))
    return {key: value for key, value in plain.items() if key in found or key not in functions}


def _u_json(read: Read, monitor: MonitorDocument, u: object) -> Json:
    """The ``u`` of a monitor, its own or that of `generate`; empty where neither is given and none is needed."""
    own = getattr(monitor, "u", None)
    if u is Later.U:
        return {} if own is None else {"u": read(own)}
    if own is not None and u is not None:
        raise BadArgument("u is given twice: alone, and in the monitor")
    function = u if own is None else own
    if function is None and "u" in monitor.NEEDED:
        raise BadArgument(f"the monitor {type(monitor).__name__} needs a function u: give u")
    return {} if function is None else {"u": read(function)}


def _read_arrays(monitor: Mapping[str, Any], read: Read) -> Json:
    """The JSON of a monitor that is JSON but for its functions, which may be arrays and callables."""
    made = dict(monitor)
    for name in FUNCTIONS:
        if name in made and not isinstance(made[name], Mapping | str | None):
            made[name] = read(made[name])
    if isinstance(made.get("monitors"), Sequence):
        made["monitors"] = [_member(member, read, Later.U) for member in made["monitors"]]
    return made


# The spec of a mesh and its options.

DEFAULT_POINTS = Grid.n_xi
"""Points a side of `generate`."""


class MeshOptions(TypedDict, total=False):
    """Options of a mesh, for `generate` and `sequences.start` of both clients. Each of them may be left out."""

    monitor: Monitor | Mapping[str, Any] | None
    """What the mesh minimises or equidistributes. Default: None, which is :class:`Auto` of u, or :class:`ArcLength` of
    u where ``a`` or ``b`` is given.
    """
    domain: Domain | Mapping[str, Any] | None
    """The domain of the mesh. Default: None, which is the unit square."""
    a: float | None
    """Strength of the arc length, from 0 to 1. Default: None, which is 0.7 where ``b`` is given. A larger one makes
    cells smaller where u is steep.
    """
    b: float | None
    """Damping of the arc length where u is steep, not negative. Default: None, which is 0.05 where ``a`` is given. A
    larger one makes cells more equal.
    """
    target: Target | Mapping[str, Any] | None
    """An interpolation error in place of ``n``. Default: None, which takes the grid of ``n``."""
    schwarz: Schwarz | Mapping[str, Any] | None
    """How the domain is divided into subdomains; on blocks by ``groups`` of them. Default: None, which solves on a
    single domain.
    """
    boundary: str
    """How points move along the sides: ``"trace"`` (default), ``"equidistributed_1d"`` or ``"orthogonal"``."""
    mode: str
    """``"discretization"`` (default) solves to the error of the grid, ``"tight"`` to rounding."""
    allow_relaxed: bool
    """Whether a weaker monitor is accepted where the requested equations have no valid solution. Default: True.
    ``mesh.relaxed`` then reports it. With False such a mesh fails.
    """
    parts: int | Literal["auto"] | None
    """How many parts of a cluster the mesh is computed in; ``"auto"`` for as many as fit its workers. Default: None,
    which takes parts only where the mesh is too large for one machine.
    """
    label: str | None
    """Free text for the list of meshes. Default: None."""
    parameters: Mapping[str, float] | None
    """Values of further names in all expressions. Default: None."""
    t: float | None
    """Value of the name t in all expressions. Default: None."""
    n_samples: int
    """Points a side at which a callable is evaluated. Default: 129. Raise it for a callable with fine detail."""


DEFAULTS: MeshOptions = {
    "monitor": None,
    "domain": None,
    "a": None,
    "b": None,
    "target": None,
    "schwarz": None,
    "boundary": MeshSpec.boundary,
    "mode": MeshSpec.mode,
    "allow_relaxed": MeshSpec.allow_relaxed,
    "parts": MeshSpec.parts,
    "label": MeshSpec.label,
    "parameters": None,
    "t": None,
    "n_samples": 129,
}
"""The default of every option."""
OF_SPEC = tuple(name for name in DEFAULTS if name in keys_of(MeshSpec))
"""The options that are keys of the spec."""


def complete_options(options: MeshOptions, method: Callable[..., object]) -> MeshOptions:
    """All options of a mesh: the arguments of ``method``, and the defaults of the others.

    Raises :class:`TypeError` for an option that the method does not have; the message names the nearest one.
    """
    unknown = [name for name in options if name not in DEFAULTS]
    if unknown:
        names = [*DEFAULTS, *(name for name in inspect.signature(method).parameters if name not in ("self", "options"))]
        nearest = get_close_matches(unknown[0], names, n=1)
        advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(names)}"
        advice = _where_it_belongs(unknown[0]) or advice
        raise TypeError(f"{method.__name__}() has no option {unknown[0]!r}; {advice}")
    return {**DEFAULTS, **options}


def _where_it_belongs(name: str) -> str | None:
    """The remedy for a setting of a target, a monitor, or the Schwarz iteration that was given as an option."""
    if name in ("points", "max_points", "error"):
        return f"give target=Target({'error' if name == 'error' else 'max_points'}=...)"
    for option, kinds in (("monitor", MONITORS.documents.values()), ("schwarz", (Schwarz,))):
        for kind in kinds:
            if name != "kind" and name in (one.name for one in fields(kind)):
                return f"it is a setting of {option}, as in {option}={kind.__name__}({name}=...)"
    return None


def points_per_side(n: int | tuple[int, int]) -> tuple[int, int]:
    """``(n_xi, n_eta)`` of ``n``: one number for both directions, or a pair.

    Raises :class:`BadArgument` for anything else; the service checks the values.
    """
    pair = n if isinstance(n, tuple | list) else (n, n)
    try:
        n_xi, n_eta = pair
        if int(n_xi) == n_xi and int(n_eta) == n_eta:
            return int(n_xi), int(n_eta)
    except (TypeError, ValueError):
        pass
    raise BadArgument(f"n is the number of points a side, an integer or a pair (n_xi, n_eta), not {n!r}")


def _schwarz_json(schwarz: object) -> Json | None:
    """The JSON of the settings of a Schwarz iteration; raises :class:`BadArgument` for another object."""
    if schwarz is None or isinstance(schwarz, Mapping):
        return None if schwarz is None else dict(schwarz)
    if not isinstance(schwarz, Schwarz):
        raise BadArgument(
            "schwarz is a Schwarz, such as Schwarz(subdomains=(2, 1)), or None for a single domain; not"
            f" {schwarz!r:.80}"
        )
    if not isinstance(schwarz.transmission, Condition):
        raise BadArgument(
            f"transmission = {str(schwarz.transmission)[:40]!r}: give one of"
            f" {', '.join(f'{kind.__name__}()' for kind in TRANSMISSIONS.documents.values())}"
        )
    return without_usual(schwarz)


def mesh_spec(
    monitor: Mapping[str, Any],
    n: int | tuple[int, int],
    options: MeshOptions = DEFAULTS,
    *,
    initial: str = "nested",
    cells: str = "quad",
) -> Json:
    """The JSON body of a request for a mesh; ``monitor`` is its JSON, which ``options`` do not replace.

    Keys unknown to services of the first release are left out where they have their default.
    """
    options = {**DEFAULTS, **options}
    n_xi, n_eta = points_per_side(n)
    target, domain = options["target"], options["domain"]
    if target is not None and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("a target takes the place of n: give one of them")
    if has_own_points(domain) and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("the blocks of a domain have numbers of cells of their own: leave n out, and refine them")
    given: Json = {
        **{name: options[name] for name in OF_SPEC},  # type: ignore[literal-required]
        "monitor": dict(monitor),
        "grid": None if target is not None or has_own_points(domain) else {"n_xi": n_xi, "n_eta": n_eta},
        "target": target.to_json() if isinstance(target, Target) else target,
        "domain": MeshSpec.domain if domain is None else domain_json(domain),
        "schwarz": _schwarz_json(options["schwarz"]),
        "initial": str(initial),
        "cells": str(cells),
    }
    spec = without_usual(MeshSpec(**given))
    return {name: value for name, value in spec.items() if name != "grid" or value is not None}


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
