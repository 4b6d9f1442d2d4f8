"""The loop: solve on a mesh, adapt to the solution, until the estimate stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any, TypeAlias, TypedDict, Unpack, overload

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.nodal_field import HermiteField
from equimesh.fields.on_domain import OnDomain, reference_on
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.kernels import Norm
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.second_order import require_degree
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.metrics import NORMS
from equimesh.monitors.tensor import Weight
from equimesh.numerics.threads import thread_count
from equimesh.numerics.types import Array
from equimesh.quality.elements import CellKind
from equimesh.rounds.estimate import EarlierValues, ErrorEstimate
from equimesh.rounds.next_mesh import KEPT, moved_cells
from equimesh.rounds.recovery import on_domain
from equimesh.rounds.round import next_mesh
from equimesh.rounds.shape import ShapeSearch, counts_within, with_counts
from equimesh.solving.solution import Solution
from equimesh.solving.solve import solve
from equimesh_coupling.adaptation import (
    Adaptation,
    AdaptRound,
    ended,
    fault_of_solver,
    first_resolved,
    require_same_kind,
    verdict_on,
    wanted_density,
)
from equimesh_coupling.errors import BadValues
from equimesh_coupling.goals import NEEDS_GOAL, Goal, GoalValues, WithAdjoint, check_goal, goal_values
from equimesh_coupling.recovery import CellAverages, ErrorIndicator, cell_values
from equimesh_coupling.values import element_values, node_values
from equimesh_schema.document import hinted, is_whole

# The next mesh of blocks for a code with unknowns in its cells, from averages over them.

DISTORTION = 4.0
"""The weight of distortion. Finite volumes lose their order where cells are oblique or change their sizes fast."""
SMOOTHNESS = 100.0
"""The weight of smoothness: behind a step OpenFOAM diverged on meshes of the usual weights, and gains by these."""


def averaged_mesh(u: QuadField, domain: Blocks, norm: Norm, threads: int) -> Mesh:
    """The next mesh of ``domain``, from ``u`` on the mesh before, with even cells. The mesh before if none is better.

    Raises as :func:`~equimesh.solving.solve.solve`.
    """
    monitor = LeastError(u=u, norm=norm, distortion=DISTORTION, smoothness=SMOOTHNESS)
    return solve(Problem(monitor=monitor, domain=domain), initial=u.mesh, check=False, threads=threads).mesh


# The next mesh from an error indicator of the solver on every cell.


def indicated_mesh(mesh: Mesh, indicator: Array, domain: Domain, norm: Norm, threads: int) -> Mesh:
    """The next mesh of ``domain`` by the ``indicator`` of the cells of ``mesh``, shape ``(n_xi - 1, n_eta - 1)``.

    Cells are wanted where the indicator is large: their density is that of the cells now, times a power of the
    indicator. A gradient map gives all cells equal shares of it. The mesh itself where the indicator is zero.
    Raises :class:`~equimesh.solving.solution.SolveError` where no valid mesh is found.
    """
    reference = reference_on(mesh, domain)
    density = wanted_density(reference.x, reference.y, indicator, norm)
    if density is None:
        return mesh
    rho = HermiteField(mesh=reference, values=density)
    monitor = Weight(rho=OnDomain(reference=rho, domain=domain), map="gradient")
    solution: Solution = solve(Problem(monitor=monitor, grid=mesh.grid, domain=domain), threads=threads)
    return solution.mesh


# What a loop does on meshes of one kind: the first mesh, and from what a solver returned to the next one.

NextMeshFunction: TypeAlias = Callable[[], tuple[Mesh, float, str]]
"""Returns the next mesh, how far it moves, and the name of its start."""
RoundAndNextMesh: TypeAlias = tuple[AdaptRound[Mesh], NextMeshFunction]
"""The record of what a solver returned, and the function that computes the next mesh."""

EVEN = "even cells"
"""The name of the descent for averages over the cells of blocks."""


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """Meshes of a ``domain``, first with the points of ``grid``, which is ``None`` on blocks."""

    domain: Domain | Blocks
    grid: Grid | None = None
    shape: ShapeSearch | None = None
    """The search for the counts of cells; ``None`` where they are given."""
    norm: Norm
    degree: int | None = None
    """The degree of the elements, 1 to 4; ``None``: that of the space of a field, 1 for arrays."""
    cells: CellKind | None = None
    """The cells of the elements; ``None``: those of the space of a field, quadrilaterals for arrays."""
    goal: Goal | None = None
    """The functional whose error meshes make small; ``None`` for the norm of the error."""
    threads: int

    @property
    def measured_norm(self) -> Norm:
        """The norm of the error by which meshes are chosen: products of two errors are those of the gradients."""
        return self.norm if self.goal is None else "h1"

    def first(self) -> tuple[Any, float, str]:
        """The uniform mesh, of blocks the initial one."""
        if isinstance(self.domain, Blocks):
            return self.domain.mesh, 0.0, "given"
        if self.grid is None:
            raise TypeError("a domain with four sides needs a grid")
        return map_mesh(Mesh.uniform(self.grid), self.domain), 0.0, "given"

    def copied(self, mesh: Mesh) -> Mesh:
        """The mesh with arrays of its own."""
        return mesh.moved(mesh.points.copy())

    def known(
        self,
        mesh: Mesh,
        values: Array,
        degree: int = 1,
        cells: CellKind = "quad",
        *,
        dual: GoalValues | None = None,
        first: AdaptRound[Mesh] | None = None,
    ) -> RoundAndNextMesh:
        """The record of values at the nodes of elements of a ``degree`` on ``cells``, and the way to the next mesh.

        ``first`` is the first round that resolved the solution.
        """
        adjoint = None if dual is None else dual.z
        is_compared = first is not None and (self.norm, degree) == ("l2", 1)
        earlier = EarlierValues(first.mesh, first.values) if first is not None and is_compared else None
        known = ErrorEstimate.of(
            mesh, values, self.domain, self.threads, require_degree(degree, cells), adjoint, earlier, cells
        )

        def following() -> tuple[Mesh, float, str]:
            of = None if self.shape is None else self.shape.next(known, self.norm, self.threads)
            found = next_mesh(known, self.measured_norm, self.threads, of)
            return on_domain(found.reference, self.domain), found.moved_cells, found.chosen

        record = record_of(known, mesh, values)
        if dual is not None and self.goal is not None and known.products is not None:
            record = replace(record, goal=self.goal.record(dual, known.products), adjoint=dual.z)
        return record, following

    def averaged(self, mesh: Mesh, values: Array, first: AdaptRound[Mesh] | None) -> RoundAndNextMesh:
        """As :meth:`known`, of values that were recovered from averages over the cells; on blocks cells stay even."""
        domain = self.domain
        if not isinstance(domain, Blocks):
            return self.known(mesh, values, cells=self.cells or "quad", first=first)
        known = ErrorEstimate.of(mesh, values, domain, self.threads)

        def following() -> tuple[Any, float, str]:
            u: Any = known.recovery.u
            found: Any = mesh if known.is_exact else averaged_mesh(u, domain, self.norm, self.threads)
            return found, moved_cells(mesh, found), KEPT if mesh.distance(found) == 0.0 else EVEN

        return record_of(known, mesh, values), following

    def indicated(self, mesh: Any, values: Array) -> RoundAndNextMesh:
        """The record of an error indicator, and the way to the next mesh; refused on blocks."""
        domain = self.domain
        if isinstance(domain, Blocks):
            raise InputError(NO_INDICATOR, field="solve")

        def following() -> tuple[Any, float, str]:
            found = indicated_mesh(mesh, values, domain, self.norm, self.threads)
            return found, moved_cells(reference_on(mesh, domain), reference_on(found, domain)), "weight"

        return AdaptRound(number=0, mesh=mesh, values=values, estimate=float(np.linalg.norm(values))), following


NO_INDICATOR = (
    "an error indicator says where cells are wanted, and equal shares of it need the lines of one grid, which blocks do"
    " not have: return values at the nodes, or CellAverages, from which the directions follow, too"
)
"""Why an error indicator is refused on blocks."""


def record_of(known: ErrorEstimate, mesh: Mesh, values: Array) -> AdaptRound[Mesh]:
    """The record of nodal values."""
    return AdaptRound(
        number=0,
        mesh=mesh,
        values=values,
        estimate=0.0 if known.is_exact else known.estimate,
        estimate_h1=known.estimate_h1,
        unresolved=known.unresolved,
    )


MAX_ROUNDS = 100
"""The most rounds that can be requested."""
POINTS_OR_N = "give either n, points a direction, or points, those of the whole grid, whose shape is then found"
"""Why both or none of the two numbers of points are refused."""
NO_DIRECTIONS = (
    "a domain in blocks has no two directions of points: leave n out for its own counts of cells, or give points, those"
    " of the whole mesh"
)
"""Why a number of points a direction is refused."""


class AdaptArguments(TypedDict, total=False):
    """The other arguments of :func:`adapt`."""

    points: int | None
    rounds: int
    norm: Norm | None
    degree: int | None
    cells: CellKind | None
    goal: Goal | None
    tolerance: float | None
    threads: int | None
    observe: Callable[[AdaptRound[Mesh]], None] | None


@overload
def adapt(
    solve: Callable[[Mesh], Any],
    n: int | tuple[int, int],
    *,
    domain: Domain = UNIT_SQUARE,
    **options: Unpack[AdaptArguments],
) -> Adaptation[Mesh]: ...
@overload
def adapt(
    solve: Callable[[Mesh], Any],
    n: None = None,
    *,
    domain: Domain | Blocks = UNIT_SQUARE,
    **options: Unpack[AdaptArguments],
) -> Adaptation[Mesh]: ...
@hinted(max_points="did you mean 'points'?")
def adapt(
    solve: Callable[[Any], Any],
    n: int | tuple[int, int] | None = None,
    *,
    domain: Domain | Blocks = UNIT_SQUARE,
    points: int | None = None,
    rounds: int = 5,
    norm: Norm | None = None,
    degree: int | None = None,
    cells: CellKind | None = None,
    goal: Goal | None = None,
    tolerance: float | None = None,
    threads: int | None = None,
    observe: Callable[[AdaptRound[Any]], None] | None = None,
) -> Adaptation[Mesh]:
    """The mesh of ``n`` points a direction, or ``(n_xi, n_eta)``, that is adapted to the solution of a solver.

    ``points`` in place of ``n`` is the number of points of the whole mesh, at most. How many lie along xi and along
    eta, on blocks along every class of opposite edges, is then found by the measured error on coarse meshes, once the
    solution is resolved: the shape of the mesh can change from round to round. A domain in blocks has counts of its
    own: without ``points`` these stay, and the first mesh is its initial one. ``n`` is refused there. With averages
    over the cells the counts of blocks are those of the domain, in proportion.

    ``solve(mesh)`` solves on an :class:`~equimesh.meshes.mesh.Mesh`, or a
    :class:`~equimesh.meshes.mesh.Mesh` of blocks, which has the methods ``to_skfem()``,
    ``to_dolfinx(comm)`` and so on, and returns one of these: values at the nodes, a field of a library with an adaptor,
    :class:`~equimesh_coupling.recovery.CellAverages`, or an :class:`~equimesh_coupling.recovery.ErrorIndicator` of the
    cells. It is called first on the uniform mesh, then at most ``rounds`` times. ``norm`` is that of the error that
    meshes minimise and by which rounds are ranked: ``"l2"`` of u, without a goal the default, or ``"h1"`` of its
    gradient. ``degree``, 1 to 4, is
    that of the elements, at whose nodes values are: see :func:`~equimesh_coupling.elements.element_shape`. Without it
    that of a field is taken, where its space shows it, and 1 for arrays. ``cells="triangle"``, of degree 1 or 2, says
    that they are the triangles into which ``mesh.triangles()`` cuts the mesh, as ``to_skfem(cells="triangle")`` does;
    without it they are those of the space, quadrilaterals for arrays. ``observe`` is called with every round.

    With a ``goal`` the error is that of a functional: the sum over the cells of the products of the errors of u and of
    the adjoint z. ``solve`` then returns :class:`~equimesh_coupling.goals.WithAdjoint`. The loop ends, too, where the
    estimated error of the functional and the change of its corrected value are at most ``tolerance`` together, on two
    meshes that resolve u and z.

    Raises :class:`~equimesh_coupling.errors.BadValues` where the values of the first solve cannot be used, and what the
    first solve raises. Later the loop ends with the best mesh so far: ``reason`` says why, ``failure`` is the
    exception. Raises :class:`~equimesh.errors.InputError` for arguments that cannot be used.
    """
    _check(solve, rounds, norm, degree, cells)
    is_blocks = isinstance(domain, Blocks)
    if is_blocks and n is not None:
        raise InputError(f"n = {n!r:.40}: {NO_DIRECTIONS}", field="n")
    if points is not None and n is not None:
        raise InputError(POINTS_OR_N, field="points")
    given, threads = None if is_blocks or points is not None else _grid(n), thread_count(threads)
    check_goal(goal, tolerance, degree, norm=norm, points=points, cells=cells)
    _check_domain(domain)
    _check_observer(observe)
    of, shape = domain if is_blocks else given, None
    if points is not None:
        shape = ShapeSearch.within(points, domain)
        of = shape.domain if is_blocks else with_counts(domain, counts_within(points, domain))
    first: Any = {"domain": of} if isinstance(of, Blocks) else {"domain": domain, "grid": of}
    by = Rounds(**first, shape=shape, norm=norm or "l2", degree=degree, cells=cells, goal=goal, threads=threads)
    return _loop(solve, by, rounds, tolerance, observe)


def _loop(
    solve: Callable[[Any], Any],
    by: Rounds,
    rounds: int,
    tolerance: float | None,
    observe: Callable[[AdaptRound[Mesh]], None] | None,
) -> Adaptation[Mesh]:
    """The loop itself, for meshes of any kind."""
    norm = by.measured_norm
    done: list[AdaptRound[Mesh]] = []
    following: NextMeshFunction = by.first
    while True:
        try:
            mesh, moved, start = following()
            # The solver gets its own arrays, which it may change.
            returned = solve(by.copied(mesh))
            record, following = _looked_at(returned, mesh, by, first_resolved(done))
            require_same_kind(done, is_indicator=isinstance(returned, ErrorIndicator))
        except Exception as failure:
            if not done:
                raise
            return ended(done, rounds, norm, failure, tolerance)
        done.append(replace(record, number=len(done), moved_cells=moved, start=start))
        if observe is not None:
            observe(done[-1])
        if verdict_on(done, rounds, norm, tolerance).is_done:
            return ended(done, rounds, norm, tolerance=tolerance)


def _looked_at(returned: Any, mesh: Mesh, by: Rounds, first: AdaptRound[Mesh] | None) -> RoundAndNextMesh:
    """The record of what a solver returned, and the way to the next mesh."""
    if by.goal is not None:
        dual = goal_values(returned, mesh, by.goal)
        return by.known(mesh, dual.u, dual=dual)
    if isinstance(returned, WithAdjoint):
        raise BadValues(NEEDS_GOAL)
    if isinstance(returned, ErrorIndicator):
        return by.indicated(mesh, cell_values(returned, mesh))
    if isinstance(returned, CellAverages):
        return by.averaged(mesh, node_values(returned, mesh), first)
    return by.known(mesh, *element_values(returned, mesh, by.degree, by.cells), first=first)


def _grid(n: Any) -> Grid:
    """The grid of a number of points, or of one a direction; raises :class:`~equimesh.errors.InputError`."""
    counts = (n, n) if isinstance(n, Integral) else n
    is_pair = isinstance(counts, tuple | list) and len(counts) == 2
    if not (is_pair and all(isinstance(one, Integral) and not isinstance(one, bool) for one in counts)):
        pair = "give a number of points a direction, or a pair (n_xi, n_eta)"
        raise InputError(f"n = {n!r:.40}: {pair}; points=4000 finds the grid of at most so many in all", field="n")
    return Grid(n_xi=int(counts[0]), n_eta=int(counts[1]))


def _check(solve: object, rounds: object, norm: object, degree: object, cells: object) -> None:
    """Refuse arguments that cannot be used."""
    if fault := fault_of_solver(solve):
        raise InputError(fault, field="solve")
    if not is_whole(rounds) or not 1 <= rounds <= MAX_ROUNDS:
        raise InputError(f"rounds = {rounds!r}: a whole number between 1 and {MAX_ROUNDS}", field="rounds")
    if norm not in (None, *NORMS):
        raise InputError(f"norm = {norm!r}: choose 'l2' or 'h1'", field="norm")
    require_degree(1 if degree is None else degree, "quad" if cells is None else cells)


def _check_domain(domain: object) -> None:
    """Refuse what is no domain."""
    is_blocks = isinstance(domain, Blocks)
    if not is_blocks and not (callable(getattr(domain, "map", None)) and callable(getattr(domain, "jacobian", None))):
        raise InputError(
            f"domain = {domain!r:.40} is no domain: give one, such as Rectangle(x=(0, 2), y=(0, 1))",
            field="domain",
        )


def _check_observer(observe: object) -> None:
    """Refuse an observer that cannot be called."""
    if observe is not None and not callable(observe):
        raise InputError("observe is no function: give one that takes the record of a round", field="observe")
