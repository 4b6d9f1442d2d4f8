"""The problem to solve: a monitor, a grid, a domain, and a boundary condition."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, TypeGuard

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.curve import FormulaPath
from equimesh.domains.domain import UNIT_SQUARE, Domain, is_closed, map_mesh
from equimesh.equations.mesh_equations import MeshEquations, NodalState, Rows, Triplets
from equimesh.equations.metric import SLOPE_STEP, ReferenceMetric, Tensor, Vector, quadratic
from equimesh.errors import InputError
from equimesh.fields.expression import Expression
from equimesh.fields.periodic import repeated
from equimesh.inputs import choice
from equimesh.meshes.mesh import IN_ALL, Grid, Mesh
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.monitor import Monitor, require_monitor
from equimesh.numerics.types import Array, IntArray
from equimesh_schema.document import hinted

# The physical boundary of the unit square: the conditions that place its nodes along each side.

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    D = TypeVar("D", Domain, Blocks, default=Domain)
else:
    from typing import TypeVar

    D = TypeVar("D", Domain, Blocks)
    """A domain with four sides, or one of blocks; the first where a type does not say it."""
S = TypeVar("S", bound=np.generic)


class Boundary(StrEnum):
    """The condition that places the nodes along the four sides.

    ``TRACE``: equal metric length with the full gradient of u, the trace of the interior equations (the default).
    ``EQUIDISTRIBUTED_1D``: equal metric length with the slope of u along the side alone, the paper's choice, equation
    (7); on fine grids it leads to folds where u is steep. ``ORTHOGONAL``: coordinate lines meet the sides of the
    reference square at right angles, equation (6); a domain's map may change these angles.
    """

    TRACE = "trace"
    EQUIDISTRIBUTED_1D = "equidistributed_1d"
    ORTHOGONAL = "orthogonal"


@dataclass(frozen=True, kw_only=True)
class Side:
    """A side of the unit square as the condition that closes a window there.

    ``axis`` is the coordinate that is fixed on the side (0: left and right, 1: bottom and top), ``end`` its fixed
    value, 0 or 1. The tangential equations hold at the nodes between the window's corners.
    """

    axis: int
    end: int
    kind: Boundary

    def rows(self, window: NodalState) -> Rows:
        """The fixed coordinate on all nodes of the side, and the tangential equations (paper, (5) to (7))."""
        fixed, tangential = (self.line(window.numbers[axis]) for axis in (self.axis, 1 - self.axis))
        values, triplets = self._tangential(window, tangential)
        position = self.line((window.x, window.y)[self.axis])
        return Rows(
            np.concatenate([fixed, tangential[1:-1]]),
            np.concatenate([position - self.end, values]),
            lambda: [(fixed, fixed, np.ones(fixed.size)), *triplets()],
        )

    def points(self, t: Array) -> Vector:
        """The reference points at positions ``t`` along the side."""
        fixed = np.full(t.shape, float(self.end))
        return (fixed, t) if self.axis == 0 else (t, fixed)

    def line(self, values: npt.NDArray[S], depth: int = 0) -> npt.NDArray[S]:
        """Nodal values on the side's own line, or ``depth`` lines into the domain."""
        index = -1 - depth if self.end else depth
        return values[index] if self.axis == 0 else values[:, index]

    def _tangential(self, window: NodalState, unknown: IntArray) -> tuple[Array, Callable[[], Triplets]]:
        if self.kind is Boundary.ORTHOGONAL:
            return self._orthogonal(window)
        return self._equidistributed(window, unknown)

    def _orthogonal(self, window: NodalState) -> tuple[Array, Callable[[], Triplets]]:
        """Zero normal derivative of the tangential coordinate, one-sided and of second order."""
        spacing = (window.d_xi, window.d_eta)[self.axis]
        position, numbers = (window.x, window.y)[1 - self.axis], window.numbers[1 - self.axis]
        rows = self.line(numbers)[1:-1]
        values = np.zeros(rows.size)
        triplets: Triplets = []
        for depth, weight in enumerate((-1.5, 2.0, -0.5)):
            values += weight / spacing * self.line(position, depth)[1:-1]
            columns = self.line(numbers, depth)[1:-1]
            triplets.append((rows, columns, np.full(rows.size, weight / spacing)))
        return values, lambda: triplets

    def _equidistributed(self, window: NodalState, unknown: IntArray) -> tuple[Array, Callable[[], Triplets]]:
        spacing = (window.d_xi, window.d_eta)[1 - self.axis]
        line = SideLine.of(self, window.metric, self.line((window.x, window.y)[1 - self.axis]))
        rows, scale = unknown[1:-1], 1.0 / spacing**2

        def triplets() -> Triplets:
            by_first, by_second = line.flux_derivatives
            return [
                (rows, unknown[:-2], -scale * by_first[:-1]),
                (rows, unknown[1:-1], scale * (by_first[1:] - by_second[:-1])),
                (rows, unknown[2:], scale * by_second[1:]),
            ]

        return scale * np.diff(line.fluxes), triplets


@dataclass(frozen=True)
class SideLine:
    """u along one side of the reference square, at its nodes: position ``t``, value, tangential and normal derivative.

    The normal derivative ``u_n`` is zero where the boundary condition ignores it.
    """

    side: Side
    metric: ReferenceMetric
    t: Array
    u: Array
    u_t: Array
    u_n: Array

    @classmethod
    def of(cls, side: Side, metric: ReferenceMetric, t: Array) -> SideLine:
        """The side with nodes at ``t``."""
        u, *gradient = metric.u_with_gradient(*side.points(t))
        seen = side.kind is Boundary.TRACE
        return cls(side, metric, t, u, gradient[1 - side.axis], gradient[side.axis] if seen else np.zeros(t.size))

    @cached_property
    def fluxes(self) -> Array:
        """The squared metric length of every edge of the side."""
        k, _, _ = self._strength
        return self._base[0] * self._d**2 + k * np.diff(self.u) ** 2

    @cached_property
    def flux_derivatives(self) -> tuple[Array, Array]:
        """The derivatives of :attr:`fluxes` by the positions of the edge's two nodes."""
        d, du, (g, _) = self._d, np.diff(self.u), self._gradient
        k, slope, raised = self._strength
        by_middle, by_normal = self._by_middle, self._normal_slopes
        found = []
        for sign, node in ((-1.0, slice(0, -1)), (1.0, slice(1, None))):
            by_du = sign * self.u_t[node]
            by_square = 2 * raised[0] * (by_du - sign * g) / d + raised[1] * by_normal[node]
            by_node = 2 * sign * d * self._base[0] + slope * by_square * du**2 + 2 * k * du * by_du
            found.append(by_node + 0.5 * by_middle)
        return found[0], found[1]

    @property
    def _d(self) -> Array:
        return np.diff(self.t)

    @property
    def _gradient(self) -> Vector:
        """The gradient of u on every edge, its tangential component first."""
        return np.diff(self.u) / self._d, (self.u_n[1:] + self.u_n[:-1]) / 2

    @property
    def _middles(self) -> Vector:
        return self.side.points((self.t[1:] + self.t[:-1]) / 2)

    @cached_property
    def _base(self) -> Tensor:
        """The pointwise part of the metric at the middles of the edges, its tangential entry first."""
        base = self._turned(self.metric.base(*self._middles))
        if self.side.kind is Boundary.EQUIDISTRIBUTED_1D:  # only the metric along the side counts
            return base[0], np.zeros(base[0].shape), np.ones(base[0].shape)
        return base

    @cached_property
    def _strength(self) -> tuple[Array, Array, Vector]:
        return self.metric.strength(self._gradient, self._base)

    @property
    def _by_middle(self) -> Array:
        """The derivative of the fluxes by the middles of the edges, where the pointwise part is taken."""
        changes = self.metric.base_slopes(*self._middles)
        if changes is None:
            return np.zeros(self.t.size - 1)
        change = self._turned(changes[1 - self.side.axis])
        if self.side.kind is Boundary.EQUIDISTRIBUTED_1D:
            change = (change[0], np.zeros(change[0].shape), np.zeros(change[0].shape))
        _, slope, raised = self._strength
        return np.asarray(change[0] * self._d**2 - slope * quadratic(change, raised) * np.diff(self.u) ** 2)

    @property
    def _normal_slopes(self) -> Array:
        """The tangential derivative of ``u_n`` at the nodes, by a difference quotient."""
        if self.side.kind is not Boundary.TRACE or self.metric.arc_length is None:
            return np.zeros(self.t.size)
        ahead, behind = np.minimum(self.t + SLOPE_STEP, 1.0), np.maximum(self.t - SLOPE_STEP, 0.0)
        u_n = [self.metric.u_with_gradient(*self.side.points(at))[1 + self.side.axis] for at in (ahead, behind)]
        return np.asarray((u_n[0] - u_n[1]) / (ahead - behind))

    def _turned(self, tensor: Tensor) -> Tensor:
        """The tensor with its tangential entry first."""
        return tensor[::-1] if self.side.axis == 0 else tensor


def sides(kind: Boundary) -> dict[tuple[int, int], Side]:
    """The four sides of the unit square by (axis, end)."""
    return {(axis, end): Side(axis=axis, end=end, kind=kind) for axis in (0, 1) for end in (0, 1)}


NO_NODAL_SOLUTION = (
    "slopes are recovered from the values at nodes on four sides, and the lines of this domain are closed: take"
    " LeastError or Auto with the NodalField itself as u"
)
"""Why closed lines with the recovery of a solver's solution are refused."""
NO_LINES = (
    "a metric is equidistributed along grid lines from side to side, and lines that run through several blocks meet"
    " re-entrant corners, where no such mesh exists: take LeastError(u=...) or Auto(u=...), which measure the error on"
    " cells and need no lines"
)
"""Why other monitors are refused on blocks."""
NO_STRAIGHT_LINES = "rectilinear = True: a domain in blocks has no lines that could stay straight; leave it out"
"""Why straight lines are refused on blocks."""
NO_CELL_CENTRES = (
    "the purpose finite_volume chooses among candidates on grids, not on blocks; leave it out, and bound the angles by"
    " orthogonality, 50 for instance"
)
"""Why the purpose is refused on blocks."""
NO_ANGLES_OF_A_ROUND = (
    "a round of adapting does not bound angles on blocks: leave the bound out, or take LeastError with the same values"
    " as u, QuadField(mesh=..., values=...), and the bound"
)
"""Why a bound of angles is refused for the values of a solver on blocks."""
NO_BOUNDARY_OF_A_ROUND = "the nodes on the sides slide for the least error in a round: leave the boundary out"
"""Why a boundary condition is refused for the values of a solver."""
OWN_CELLS = "the blocks of the domain have numbers of cells of their own: leave the grid out, and refine the blocks"
"""Why a grid is refused on blocks."""
SLIDING_NODES = "the nodes on the curves of blocks slide for the least error: leave the boundary out"
"""Why a boundary condition is refused on blocks."""


def require_domain(domain: object) -> None:
    """Raise :class:`~equimesh.errors.InputError` for what is neither a domain with four sides nor one of blocks."""
    if not isinstance(domain, Blocks) and not all(
        callable(getattr(domain, name, None)) for name in ("map", "jacobian")
    ):
        raise InputError(
            f"domain = {domain!r:.40} is no domain: give one, such as Rectangle(x=(0, 2), y=(0, 1))",
            field="domain",
        )


@hinted(points=IN_ALL)
@dataclass(frozen=True)
class Problem(Generic[D]):
    """A mesh of ``domain``, by ``monitor``.

    A domain with four sides needs a ``grid``. The mesh has its points, and is locally equidistributed in the metric of
    the monitor, or of least error where that is a :class:`~equimesh.monitors.least_error.LeastError` or an
    :class:`~equimesh.monitors.least_error.Auto`.

    A domain in :class:`~equimesh.blocks.blocks.Blocks` has numbers of cells of its own: ``grid`` is ``None`` there. The
    mesh has the nodes, cells and sides of its initial mesh, with other positions of the nodes. Lines that run through
    several blocks cannot be equidistributed: the monitor is one of these two, or a
    :class:`~equimesh.monitors.least_error.NodalSolution` with values on a mesh of the domain.

    The monitor is bound to the domain, and its functions are continued where lines are closed. Raises
    :class:`~equimesh.errors.InputError`, which names the field, where something cannot be used on the domain.
    """

    monitor: Monitor
    grid: Grid = None  # type: ignore[assignment] # blocks have none
    _: KW_ONLY
    boundary: Boundary = Boundary.TRACE
    domain: D = UNIT_SQUARE  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "boundary", choice(Boundary, self.boundary, "boundary"))
        if isinstance(self.domain, Blocks):
            self._check_blocks()
            object.__setattr__(self, "monitor", self.monitor.on(self.domain))  # type: ignore[arg-type]
        else:
            self._check_sides()
            monitor = repeated(self.monitor, self.domain) if is_closed(self.domain) else self.monitor
            object.__setattr__(self, "monitor", monitor.on(self.domain))

    def _check_sides(self) -> None:
        """Refuse what a domain with four sides cannot have."""
        if not isinstance(self.grid, Grid):
            raise InputError(f"grid = {self.grid!r}: give Grid(n_xi=..., n_eta=...)", field="grid")
        require_monitor(self.monitor)
        require_domain(self.domain)
        if is_closed(self.domain) and isinstance(self.monitor, NodalSolution):
            raise InputError(NO_NODAL_SOLUTION, field="monitor")
        if isinstance(self.monitor, NodalSolution) and self.boundary is not Boundary.TRACE:
            raise InputError(NO_BOUNDARY_OF_A_ROUND, field="boundary")

    def _check_blocks(self) -> None:
        """Refuse what a domain in blocks cannot have."""
        monitor: Any = self.monitor
        if self.grid is not None:
            raise InputError(OWN_CELLS, field="grid")
        if self.boundary is not Boundary.TRACE:
            raise InputError(SLIDING_NODES, field="boundary")
        if not isinstance(monitor, LeastError | Auto | NodalSolution):
            raise InputError(NO_LINES, field="monitor")
        if isinstance(monitor, LeastError) and monitor.rectilinear:
            raise InputError(NO_STRAIGHT_LINES, field="monitor.rectilinear")
        if isinstance(monitor, Auto) and monitor.purpose == "finite_volume":
            raise InputError(NO_CELL_CENTRES, field="monitor.purpose")
        if isinstance(monitor, NodalSolution) and monitor.orthogonality is not None:
            raise InputError(NO_ANGLES_OF_A_ROUND, field="monitor.orthogonality")

    @property
    def points(self) -> int:
        """Number of nodes."""
        return len(self.domain.mesh.points) if isinstance(self.domain, Blocks) else self.grid.points

    @property
    def initial(self) -> Mesh:
        """The mesh with which others are compared: the uniform mesh of the domain, of blocks their initial mesh."""
        return self.domain.mesh if isinstance(self.domain, Blocks) else map_mesh(Mesh.uniform(self.grid), self.domain)

    @cached_property
    def metric(self) -> ReferenceMetric:
        """The metric on the reference square, where everything is solved."""
        domain: Any = self.domain
        return ReferenceMetric(self.monitor, domain)

    def on_grid(self, grid: Grid) -> Problem[D]:
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


def in_blocks(problem: Problem[Any]) -> TypeGuard[Problem[Blocks]]:
    """Whether the domain of a problem has blocks."""
    return isinstance(problem.domain, Blocks)


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
