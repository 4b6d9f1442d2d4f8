"""From a spec to the solver's objects. What does not fit is refused with a pointer into the spec."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import equimesh
from equimesh.errors import InputError
from equimesh_service import spec as sp
from equimesh_service.document import escaped
from equimesh_service.problems import complaint_of, refused

_SECTIONS = {
    "a": "/monitor/a",
    "b": "/monitor/b",
    "subdomains": "/schwarz/subdomains",
    "overlap": "/schwarz/overlap",
}
_TRANSMISSIONS = {
    "classical": equimesh.Classical,
    "linear_robin": equimesh.LinearRobin,
    "nonlinear_robin": equimesh.NonlinearRobin,
}


def build_problem(spec: sp.MeshSpec, field: equimesh.Field) -> equimesh.Problem:
    """The solver's problem; raises a 422 problem with pointers."""
    with pointing(""):
        monitor = equimesh.ArcLength(u=field, a=spec.monitor.a, b=spec.monitor.b)
        grid = equimesh.Grid(n_xi=spec.grid.n_xi, n_eta=spec.grid.n_eta)
        return equimesh.Problem(monitor=monitor, grid=grid, boundary=equimesh.Boundary(spec.boundary))


def build_schwarz(spec: sp.MeshSpec) -> equimesh.Schwarz | None:
    """The settings of the Schwarz iteration, None for a single domain; raises a 422 problem with pointers."""
    asked = spec.schwarz
    if asked is None:
        return None
    with pointing(""):
        given = asked.transmission
        kind = _TRANSMISSIONS[given.kind]
        transmission = kind() if isinstance(given, sp.ClassicalSpec) else kind(p=given.p)
        along_xi, along_eta = asked.subdomains
        settings = equimesh.Schwarz(
            subdomains=(along_xi, along_eta),
            overlap=asked.overlap,
            transmission=transmission,
            ordering=equimesh.Ordering(asked.ordering),
            tolerance=asked.tolerance,
            max_iterations=asked.max_iterations,
            compare_single_domain=asked.compare_single_domain,
        )
        settings.decompose(equimesh.Grid(n_xi=spec.grid.n_xi, n_eta=spec.grid.n_eta))
    return settings


def build_field(source: sp.ExpressionSource | sp.GridSource | sp.ScatteredSource) -> equimesh.Field:
    """u as the solver takes it, from what stands in the spec itself; raises a 422 problem with pointers."""
    match source:
        case sp.ExpressionSource():
            with pointing("/monitor/u", default="expression"):
                return build_expression(source)
        case sp.GridSource(grid=given):
            with pointing("/monitor/u/grid"):
                return equimesh.GridSamples(x=given.x, y=given.y, values=given.values)
        case sp.ScatteredSource(scattered=given):
            with pointing("/monitor/u/scattered"):
                return equimesh.ScatteredSamples(points=given.points, values=given.values)


def build_expression(source: sp.ExpressionSource | sp.ExpressionCheck) -> equimesh.Expression:
    """The expression, known to be finite on the unit square; raises what the solver raises."""
    expression = equimesh.Expression(source.expression, parameters=source.parameters, t=source.t)
    expression.check_finite()
    return expression


@contextmanager
def pointing(section: str, *, default: str = "") -> Iterator[None]:
    """Turn what the solver refuses into a 422 problem that points into ``section`` of the body."""
    try:
        yield
    except InputError as error:
        raise refused([complaint_of(error, _pointer(section, error.field or default))]) from None


def _pointer(section: str, field: str) -> str:
    if not section and field in _SECTIONS:
        return _SECTIONS[field]
    parts = [part for part in field.split(".") if part]
    if not section and parts[:1] == ["transmission"]:
        parts.insert(0, "schwarz")
    return section + "".join(map(escaped, parts))
