"""The problem to solve: a monitor, a grid, a domain, and a boundary condition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property

from equimesh.blocks.blocks import Blocks
from equimesh.domains.curve import FormulaPath
from equimesh.domains.domain import UNIT_SQUARE, Domain, is_closed
from equimesh.equations.boundary import Boundary, sides
from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.metric import ReferenceMetric
from equimesh.errors import InputError
from equimesh.fields.expression import Expression
from equimesh.fields.periodic import repeated
from equimesh.inputs import choice
from equimesh.meshes.grid import Grid
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.nodal_solution import NodalSolution

NO_NODAL_SOLUTION = (
    "slopes are recovered from the values at nodes on four sides, and the lines of this domain are closed: take"
    " LeastError or Auto with the NodalField itself as u"
)
"""Why closed lines with the recovery of a solver's solution are refused."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A mesh of ``domain``: locally equidistributed in the metric of ``monitor``, on the points of ``grid``.

    The monitor is bound to the domain, and its functions are continued where lines are closed. Raises
    :class:`~equimesh.errors.InputError` where it cannot be used there.
    """

    monitor: Monitor
    grid: Grid
    boundary: Boundary = Boundary.TRACE
    domain: Domain = UNIT_SQUARE

    def __post_init__(self) -> None:
        if not isinstance(self.grid, Grid):
            raise InputError(f"grid = {self.grid!r}: give Grid(n_xi=..., n_eta=...)", field="grid")
        if not callable(getattr(self.monitor, "metric", None)):
            raise InputError(
                f"monitor = {str(self.monitor)[:40]!r} is no monitor: give one, such as ArcLength(u=...)",
                field="monitor",
            )
        if isinstance(self.domain, Blocks):
            raise InputError(
                "a domain in blocks has its own mesh, and no grid: give BlockProblem(monitor=..., domain=...)",
                field="domain",
            )
        if not (callable(getattr(self.domain, "map", None)) and callable(getattr(self.domain, "jacobian", None))):
            raise InputError(
                f"domain = {str(self.domain)[:40]!r} is no domain: give one, such as Rectangle(x=(0, 2), y=(0, 1))",
                field="domain",
            )
        if is_closed(self.domain) and isinstance(self.monitor, NodalSolution):
            raise InputError(NO_NODAL_SOLUTION, field="monitor")
        object.__setattr__(self, "boundary", choice(Boundary, self.boundary, "boundary"))
        object.__setattr__(self, "monitor", repeated(self.monitor, self.domain).on(self.domain))

    @cached_property
    def metric(self) -> ReferenceMetric:
        """The metric on the reference square, where everything is solved."""
        return ReferenceMetric(self.monitor, self.domain)

    def on_grid(self, grid: Grid) -> Problem:
        """The same problem on another grid, with the same :attr:`metric`, whose measures of u are taken once."""
        other = replace(self, grid=grid)
        object.__setattr__(other, "metric", self.metric)
        return other

    def equations(self, cross_line: float = 0.0) -> MeshEquations:
        """The discrete equations of the whole grid: the single-domain problem."""
        return MeshEquations(
            self.metric,
            self.grid.shape,
            (self.grid.d_xi, self.grid.d_eta),
            list(sides(self.boundary).values()),
            cross_line,
        )


# The formulas of a problem that were typed in another spelling than that of the language.


def understood(problem: object) -> dict[str, str]:
    """The formulas of a problem as they were understood, by their place in it: ``{"monitor.u": "2*x"}`` for ``2x``.

    Those that are in the language itself are left out.
    """
    return dict(_differences(problem, ""))


def _differences(part: object, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(part, Expression):
        if part.understood != part.text:
            yield place, part.understood
    elif isinstance(part, FormulaPath):
        for name, typed, read in zip("xy", (part.x, part.y), part.understood, strict=True):
            if read != typed:
                yield f"{place}.{name}", read
    elif isinstance(part, Mapping):
        for key, value in part.items():
            yield from _differences(value, f"{place}.{key}")
    elif isinstance(part, tuple) and part and is_dataclass(part[0]):
        for number, value in enumerate(part):
            yield from _differences(value, f"{place}[{number}]")
    elif is_dataclass(part) and not isinstance(part, type):
        for field in fields(part):
            if field.init:
                inner = place if field.name == "path" else f"{place}.{field.name}".removeprefix(".")
                yield from _differences(getattr(part, field.name), inner)
