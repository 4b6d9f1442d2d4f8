"""From a spec to the solver's objects. What does not fit is refused with a pointer into the spec."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import equimesh
from equimesh.errors import InputError
from equimesh_service.assembly.samples import Arrays, field_of
from equimesh_service.problems.problem import complaint_of, invalid_input
from equimesh_service.spec import domains as dm
from equimesh_service.spec import mesh as sp
from equimesh_service.spec import monitors as mn
from equimesh_service.spec import schwarz as sw
from equimesh_service.spec import sources as sr
from equimesh_service.spec.document import escaped

Samples: TypeAlias = Path | Arrays
"""Stored samples, or those that have just come."""
SamplesOf: TypeAlias = Callable[[str], Samples]
"""The samples with an id."""

_SECTIONS = {"subdomains": "/schwarz/subdomains", "overlap": "/schwarz/overlap"}
_NAMES = {"radius": "smoothing"}


def build_problem(spec: sp.MeshSpec, find: SamplesOf) -> equimesh.Problem:
    """The solver's problem, its monitor bound to the domain; raises a 422 problem with pointers."""
    grid = build_grid(spec)
    domain = build_domain(spec.domain)
    monitor = build_monitor(spec.monitor, domain, find)
    with pointing("/monitor"):
        monitor = monitor.on(domain)
    with pointing(""):
        boundary = equimesh.Boundary(spec.boundary)
        return equimesh.Problem(monitor=monitor, grid=grid, boundary=boundary, domain=domain)


def check_problem(spec: sp.MeshSpec, samples: Mapping[str, Samples]) -> None:
    """Raise what :func:`build_problem` raises; ``samples`` are found by their ids."""
    build_problem(spec, samples.__getitem__)


def build_grid(spec: sp.MeshSpec) -> equimesh.Grid:
    """The grid; raises a 422 problem with pointers."""
    with pointing(""):
        return equimesh.Grid(n_xi=spec.grid.n_xi, n_eta=spec.grid.n_eta)


def build_schwarz(spec: sp.MeshSpec) -> equimesh.Schwarz | None:
    """The settings of the Schwarz iteration, None for a single domain; raises a 422 problem with pointers."""
    asked = spec.schwarz
    if asked is None:
        return None
    with pointing(""):
        along_xi, along_eta = asked.subdomains
        settings = equimesh.Schwarz(
            subdomains=(along_xi, along_eta),
            overlap=asked.overlap,
            transmission=build_transmission(asked.transmission),
            ordering=equimesh.Ordering(asked.ordering),
            line_correction=asked.line_correction,
            acceleration="auto" if asked.acceleration == "auto" else equimesh.Acceleration(asked.acceleration),
            local_solver=equimesh.LocalSolver(asked.local_solver),
            fallback=asked.fallback,
            tolerance=asked.tolerance,
            max_iterations=asked.max_iterations,
            compare_single_domain=asked.compare_single_domain,
        )
        settings.decompose(equimesh.Grid(n_xi=spec.grid.n_xi, n_eta=spec.grid.n_eta))
    return settings


def build_transmission(given: sw.AnyTransmission) -> equimesh.TransmissionCondition:
    """The transmission condition; raises what the solver raises."""
    match given:
        case sw.OptimizedSpec():
            return equimesh.Optimized(data=equimesh.LineData(given.data))
        case sw.ClassicalSpec():
            return equimesh.Classical()
        case sw.LinearRobinSpec():
            return equimesh.LinearRobin(p=given.p)
        case sw.NonlinearRobinSpec():
            return equimesh.NonlinearRobin(p=given.p)


def build_domain(given: dm.AnyDomain) -> equimesh.Domain:
    """The domain; raises a 422 problem with pointers."""
    with pointing(""):
        match given:
            case dm.RectangleSpec():
                return equimesh.Rectangle(x=_pair(given.x), y=_pair(given.y))
            case dm.AnnulusSectorSpec():
                center, radii, angles = map(_pair, (given.center, given.radii, given.angles))
                return equimesh.AnnulusSector(center=center, radii=radii, angles=angles)
            case dm.QuadrilateralSpec():
                sides = {name: _curve(getattr(given, name), name) for name in ("bottom", "right", "top", "left")}
                return equimesh.Quadrilateral(**sides)


def build_monitor(
    given: mn.AnyMonitor, domain: equimesh.Domain, find: SamplesOf, pointer: str = "/monitor"
) -> equimesh.Monitor:
    """The monitor, not bound to the domain yet; raises a 422 problem with pointers."""

    def read(name: str) -> equimesh.Field:
        return build_field(getattr(given, name), domain, find, f"{pointer}/{name}")

    def optional(name: str) -> equimesh.Field | None:
        return None if getattr(given, name) is None else read(name)

    monitor: equimesh.Monitor
    with pointing(pointer):
        match given:
            case mn.ArcLengthSpec():
                monitor = equimesh.ArcLength(u=read("u"), a=given.a, b=given.b)
            case mn.CurvatureSpec():
                monitor = equimesh.Curvature(u=read("u"), norm=given.norm, isotropic=given.isotropic)
            case mn.WeightSpec():
                monitor = equimesh.Weight(rho=read("rho"), u=optional("u"))
            case mn.TensorSpec():
                monitor = equimesh.Tensor(m11=read("m11"), m12=read("m12"), m22=read("m22"), u=optional("u"))
            case mn.IntersectionSpec():
                members = [
                    build_monitor(member, domain, find, f"{pointer}/monitors/{number}")
                    for number, member in enumerate(given.monitors)
                ]
                monitor = equimesh.Intersection(monitors=tuple(members))
        if given.smoothing != 0.0:
            monitor = equimesh.Smoothed(monitor=monitor, radius=given.smoothing)
    return monitor


def build_field(source: sr.AnySource, domain: equimesh.Domain, find: SamplesOf, pointer: str) -> equimesh.Field:
    """A function as the solver takes it, good on the whole domain; raises a 422 problem with pointers."""
    match source:
        case sr.ExpressionSource():
            with pointing(pointer, default="expression"):
                return build_expression(source, domain)
        case sr.GridSource(grid=given):
            with pointing(f"{pointer}/grid"):
                return equimesh.GridSamples(x=given.x, y=given.y, values=given.values, box=domain.box)
        case sr.ScatteredSource(scattered=given):
            with pointing(f"{pointer}/scattered"):
                return equimesh.ScatteredSamples(points=given.points, values=given.values, box=domain.box)
        case sr.StoredSource(samples=name):
            samples = find(name)
            with pointing(f"{pointer}/samples"):
                return field_of(samples, domain.box)


def build_expression(source: sr.ExpressionSource | sp.ExpressionCheck, domain: equimesh.Domain) -> equimesh.Expression:
    """The expression, known to be finite on the domain; raises what the solver raises."""
    expression = equimesh.Expression(source.expression, parameters=source.parameters, t=source.t)
    expression.check_finite(domain=domain)
    return expression


@contextmanager
def pointing(section: str, *, default: str = "") -> Iterator[None]:
    """Turn what the solver refuses into a 422 problem that points into ``section`` of the body."""
    try:
        yield
    except InputError as error:
        raise invalid_input([complaint_of(error, _pointer(section, error.field or default))]) from None


def _pointer(section: str, field: str) -> str:
    if not section and field in _SECTIONS:
        return _SECTIONS[field]
    parts = [_NAMES.get(part, part) for part in field.split(".") if part]
    if not section and parts[:1] == ["transmission"]:
        parts.insert(0, "schwarz")
    return section + "".join(map(escaped, parts))


def _pair(given: list[float]) -> tuple[float, float]:
    return given[0], given[1]


def _curve(given: dm.AnyCurve, side: str) -> equimesh.Curve:
    if isinstance(given, dm.PointCurve):
        return equimesh.Curve.through(given.points, side=side)
    return equimesh.Curve.of_expressions(given.x, given.y, given.parameters, side=side)
