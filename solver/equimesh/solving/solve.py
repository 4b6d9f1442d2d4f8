"""One call from a problem to its mesh, and the methods that make meshes: values with settings of their own."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeAlias, Unpack, overload

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Rectangle, closed_of, is_closed, map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, smallest_tolerance
from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.inputs import choice, require_flag
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.restricted import Subdomains, owners
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.monitor import map_of, require_lines
from equimesh.numerics.threads import thread_count
from equimesh.numerics.types import Array
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.auto import Choice, choose_monitor, least_errors
from equimesh.solving.finite_volumes import solve_for_finite_volumes, uniform_solution
from equimesh.solving.least_error import (
    comparison_share,
    is_no_worse,
    solve_least_error,
    solve_round,
)
from equimesh.solving.orthogonality import Corners, bounded, bounded_round, require_possible
from equimesh.solving.schwarz import solve_by_schwarz
from equimesh.solving.single_domain import (
    is_lost_in_rounding,
    require_open,
    solution_lost_in_rounding,
    solve_single_domain,
)
from equimesh.solving.solution import AnySolution, OnBlocks, Solution, SolveError, degree_of
from equimesh.solving.status import Announcer, Initial, SolveArguments, SolveOptions, complete_arguments
from equimesh.sweeps.deviation import deviation
from equimesh_schema import Candidate

# Largest deviation of squared metric lengths from the mean of their line, as a share of it, at which a given mesh is
# near enough to start from: a front may have moved by half a cell.
MAX_START_DEVIATION = 0.25
NO_STRAIGHT_LINES = (
    "rectilinear = True: straight lines run through all subdomains, which move nodes on their own; leave it or the"
    " Schwarz settings out"
)
"""The reason why straight lines with Schwarz settings are refused."""
NO_SOLVERS_PARTS = (
    "purpose = 'finite_element': the error of a solver belongs to the whole mesh, and subdomains descend on that of"
    " interpolation: leave the purpose or the Schwarz settings out"
)
"""The reason why the error of a solver with Schwarz settings is refused."""
NO_ROUNDS = "values of a solver are adapted to on the whole mesh: leave the Schwarz settings out, or take LeastError"
"""The reason why subdomains are refused for values of a solver."""
NO_START_OF_A_ROUND = "a round starts from the mesh of the values: leave initial out"
"""The reason why a start is refused for values of a solver."""
NO_DEGREE = (
    "with auto, subdomains equidistribute a metric, which is made for elements of degree 1: leave the Schwarz settings"
    " or the degree out, or take least_error, whose subdomains descend on the error"
)
"""The reason why a degree of auto with Schwarz settings is refused."""
NO_BETTER_FOR_SOLVERS = "No candidate has a smaller error of a solver than the {} mesh, which this is."
"""The note of the uniform mesh of a grid, or of the initial one of blocks."""

AnyStart: TypeAlias = Initial | Mesh
"""The start of a solve: a word, or a mesh of the reference square or of the blocks."""


@overload
def solve(problem: Problem, schwarz: Schwarz | None = None, **options: Unpack[SolveArguments]) -> Solution: ...
@overload
def solve(problem: Problem[Blocks], schwarz: Schwarz | None = None, **options: Unpack[SolveArguments]) -> OnBlocks: ...
def solve(
    problem: Problem[Any],
    schwarz: Schwarz | None = None,
    **options: Unpack[SolveArguments],
) -> AnySolution:
    """The mesh of ``problem``: of least error where its monitor asks for that, else locally equidistributed.

    With ``schwarz`` the mesh is found by an iteration between subdomains: rectangles of a grid, or blocks. The mesh of
    a domain in blocks is one of least error. With an ``Auto`` monitor subdomains of a grid equidistribute.

    ``options`` are the keys of :class:`~equimesh.solving.status.SolveArguments`: ``initial``, ``mode``,
    ``allow_relaxed``, ``threads``, ``observe`` and ``check``.

    Raises :class:`~equimesh.solving.solution.SolveError`, which carries the partial solution, when the mesh is not the
    requested one; with ``check=False`` the status reports it instead. A folded mesh is never a success. Raises
    :class:`~equimesh.errors.InputError` for values of options that cannot be used, and :class:`TypeError` for an option
    that does not exist.
    """
    _check_arguments(problem, schwarz)
    arguments = complete_arguments(options)
    given: dict[str, Any] = {name: arguments[name] for name in ("mode", "allow_relaxed") if name in options}
    return solve_by(method_of(problem, schwarz, **given), problem, arguments)


# Methods: how meshes are made. Each has its own settings, and refuses what it cannot do before any work.


class Method(Protocol):
    """How the mesh of a problem is made."""

    def require(self, problem: Problem[Any], initial: AnyStart) -> None:
        """Raise :class:`~equimesh.errors.InputError` for problems and starts that the method cannot solve."""
        ...

    def solve(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution, within the bound of its angles if the monitor of the problem has one."""
        ...


def method_of(problem: Problem[Any], schwarz: Schwarz | None = None, **settings: Any) -> Method:
    """The method that belongs to the monitor of a problem, with the settings of the short form.

    ``settings`` are those of :class:`Equidistribute`. Raises :class:`~equimesh.errors.InputError` for some that the
    method does not have.
    """
    if in_blocks(problem) and settings:
        name = next(iter(settings))
        raise InputError(f"{name} belongs to equidistribution, which blocks do not have: leave it out", field=name)
    monitor = problem.monitor
    if isinstance(monitor, NodalSolution):
        if schwarz is not None:
            raise InputError(NO_ROUNDS, field="schwarz")
        return Round()
    if isinstance(monitor, LeastError):
        return MinimiseError(schwarz=schwarz)
    if in_blocks(problem):
        return Best(minimise=MinimiseError(schwarz=schwarz))
    equidistribute = Equidistribute(schwarz=schwarz, **settings)
    return Best(equidistribute=equidistribute) if isinstance(monitor, Auto) else equidistribute


def solve_by(method: Method, problem: Problem[Any], arguments: SolveArguments) -> AnySolution:
    """The mesh of ``problem`` by a ``method``, as :func:`solve`, with all of its arguments."""
    checked = SolveOptions(threads=thread_count(arguments["threads"]), observer=Announcer.of(arguments["observe"]))
    start = checked_start(problem, arguments["initial"])
    method.require(problem, start)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        solution = method.solve(problem, start, checked)
    if arguments["check"] and not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


@dataclass(frozen=True, kw_only=True)
class Equidistribute:
    """Equal lengths of edges in the metric of the monitor, along the lines of a grid."""

    schwarz: Schwarz | None = None
    """The settings of a Schwarz iteration; ``None`` for a solve of the whole grid."""
    mode: Mode = Mode.DISCRETIZATION
    """The condition that ends a single-domain solve."""
    allow_relaxed: bool = True
    """Whether a mesh of relaxed equations is a success."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", choice(Mode, self.mode, "mode"))
        require_flag(self.allow_relaxed, "allow_relaxed")

    def require(self, problem: Problem[Any], initial: AnyStart) -> None:
        """Refuse a monitor or a domain that subdomains cannot solve, and a grid that is too fine for its start."""
        if self.schwarz is not None:
            self.schwarz.require_equations()
            if degree_of(problem.monitor) > 1:
                raise InputError(NO_DEGREE, field="monitor.degree")
        closed = is_closed(problem.domain)
        if initial is Initial.UNIFORM and not closed and problem.grid.points > MAX_FACTORISED_POINTS:
            raise InputError(
                f"a start from the uniform mesh takes Newton's method, on at most {MAX_FACTORISED_POINTS} points;"
                f" {problem.grid} are more: start nested",
                field="initial",
            )
        require_possible(problem)
        if self.schwarz is not None:
            require_lines(problem.monitor)
        require_open(problem, self.schwarz)

    def solve(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution for the requested monitor, or for a weaker one within the bound of its angles."""

        def again(weaker: Problem[Any], _: Corners | None) -> AnySolution:
            return self.once(weaker, _without_mesh(initial), options.part(None, doing="for smaller angles"))

        return bounded(self.once(problem, initial, options), again)

    def once(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution for the requested monitor, whatever its angles."""
        starts = map_of(problem.monitor) == "lines"  # a gradient map has no use for a mesh to start from
        is_far = isinstance(initial, Mesh) and starts and (initial.is_folded or not _is_near(problem, initial))
        start: Any = Initial.NESTED if is_far else initial
        if is_lost_in_rounding(problem):
            solution = solution_lost_in_rounding(problem, self.schwarz, self.mode)
        elif self.schwarz is None:
            solution = solve_single_domain(problem, start, options, self.mode, allow_relaxed=self.allow_relaxed)
        else:
            solution = solve_by_schwarz(problem, self.schwarz, start, options, allow_relaxed=self.allow_relaxed)
        if is_far:
            detour = "The given mesh is too far from the solution to start from; the start was nested."
            note = f"{detour} {solution.note}".strip()
            solution = replace(solution, detours=(detour, *solution.detours), note=note)
        return replace(solution, threads=options.threads)


@dataclass(frozen=True, kw_only=True)
class MinimiseError:
    """Descent on the interpolation error of u, on a grid or on blocks."""

    schwarz: Schwarz | None = None
    """The settings of the subdomains of the finest mesh; ``None`` for a descent of the whole mesh."""
    coarse: DescentEnd | None = None
    """A mesh of a coarse level from which the solve continues."""

    def require(self, problem: Problem[Any], initial: AnyStart) -> None:  # noqa: ARG002
        """Refuse subdomains that do not fit the domain."""
        if not in_blocks(problem):
            require_possible(problem)
        if self.schwarz is not None:
            count_subdomains(problem, self.schwarz)

    def solve(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution for the weights of the monitor, or for larger ones within the bound of its angles."""

        def again(weaker: Problem[Any], corners: Corners | None) -> AnySolution:
            telling = options.part(None, doing="for smaller angles")
            return solve_least_error(
                weaker, _without_mesh(initial), telling, subdomains=self.subdomains, corners=corners
            )

        return bounded(self.once(problem, initial, options), again)

    def once(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution for the weights of the monitor, whatever its angles."""
        return solve_least_error(problem, initial, options, coarse=self.coarse, subdomains=self.subdomains)

    @property
    def subdomains(self) -> Subdomains | None:
        """The subdomains of the finest mesh."""
        return None if self.schwarz is None else Subdomains(settings=self.schwarz)


@dataclass(frozen=True, kw_only=True)
class Round:
    """The next mesh for the values of a solver, or their least-error mesh where the angles of that have a bound."""

    points: int | None = None
    """The most points of the mesh, whose counts are then chosen; ``None`` for those of the mesh of the values."""

    def require(self, problem: Problem[Any], initial: AnyStart) -> None:
        """Refuse a start, and a bound of angles that no mesh of the grid can have."""
        if initial is not Initial.NESTED:
            raise InputError(NO_START_OF_A_ROUND, field="initial")
        if not in_blocks(problem):
            require_possible(problem)

    def solve(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:  # noqa: ARG002
        """The solution with the next mesh."""

        def again(weaker: Problem[Any], _: Corners | None) -> AnySolution:
            return solve_least_error(weaker, Initial.NESTED, options.part(None, doing="for smaller angles"))

        return bounded_round(solve_round(problem, options.threads, self.points), again)


METRICS_ONLY = (
    "Subdomains equidistribute for auto, which compared metrics alone: LeastError(u=...), least_error over HTTP, takes"
    " subdomains, too, and most often has a smaller error."
)
"""The warning where an ``Auto`` monitor has Schwarz settings on a grid."""


@dataclass(frozen=True, kw_only=True)
class Best:
    """The best of the two methods and of several settings, by the error on a coarse mesh or by that of a code.

    With subdomains a grid is equidistributed, and on blocks the error is minimised.
    """

    equidistribute: Equidistribute = field(default_factory=Equidistribute)
    minimise: MinimiseError = field(default_factory=MinimiseError)

    def require(self, problem: Problem[Any], initial: AnyStart) -> None:
        """Refuse what the method that may be chosen refuses."""
        (self.minimise if in_blocks(problem) else self.equidistribute).require(problem, initial)

    def solve(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution by the best monitor.

        From a given mesh the error is minimised without a comparison, which would take longer than that.
        """
        auto: Any = problem.monitor
        if auto.purpose == "finite_volume":
            return self._for_finite_volumes(problem, initial, options)
        if not self._has_metrics_only and not isinstance(initial, Initial):  # chosen before, or as good as any
            return self.minimise.solve(replace(problem, monitor=auto.least_error()), initial, options)
        found = self._of_candidates(problem, initial, options)
        return replace(found, detours=(*found.detours, METRICS_ONLY)) if self._has_metrics_only else found

    def _of_candidates(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        """The solution for the best monitor; of least error where the mesh of another one turns out to be worse."""
        auto: Any = problem.monitor
        subdomains = self.minimise.subdomains
        if subdomains is not None:  # these descend on the error of interpolation
            auto = replace(auto, purpose="interpolation")
            problem = replace(problem, monitor=auto)
        share = None
        if not self._has_metrics_only:
            count = len(least_errors(auto, on_blocks=in_blocks(problem)))
            solve = LeastErrorSolve(
                monitor=auto.least_error(), domain=problem.domain, grid=problem.grid, subdomains=subdomains
            )
            share = comparison_share(solve.levels, count)
        found = choose_monitor(
            problem, options.part(0.0, share), metrics_only=self._has_metrics_only, subdomains=subdomains
        )
        solution, rest = None, options.part(0.0 if share is None else share)
        while solution is None or not _is_no_worse(solution, auto, found):
            chosen = replace(problem, monitor=found.chosen.monitor)
            solution = self._member(chosen, found.chosen.coarse).solve(chosen, initial, rest)
            rest = options.part(None, doing="another monitor")
            solution = _compared(solution, found.comparison)
            if found.least_error is None:
                break
            found = found.least_error
        if auto.compares_solvers and not _is_no_worse(solution, auto, found):
            note = NO_BETTER_FOR_SOLVERS.format(problem.initial.compared_with)
            return replace(uniform_solution(problem, auto, note), comparison=found.comparison)
        return solution

    def _for_finite_volumes(self, problem: Problem[Any], initial: AnyStart, options: SolveOptions) -> AnySolution:
        whole = replace(self, equidistribute=replace(self.equidistribute, schwarz=None))

        def single(candidate: Problem, part: SolveOptions) -> Solution:
            return whole._member(candidate).once(candidate, Initial.NESTED, part)

        def final(candidate: Problem, part: SolveOptions) -> Solution:
            return self._member(candidate).once(candidate, initial, part)

        return solve_for_finite_volumes(problem, options, single, final if self._has_metrics_only else None)

    def _member(self, candidate: Problem[Any], coarse: DescentEnd | None = None) -> Equidistribute | MinimiseError:
        """The method that belongs to the monitor of a candidate."""
        is_minimised = isinstance(candidate.monitor, LeastError)
        return replace(self.minimise, coarse=coarse) if is_minimised else self.equidistribute

    @property
    def _has_metrics_only(self) -> bool:
        """Whether subdomains equidistribute: no candidate minimises the error then."""
        return self.equidistribute.schwarz is not None


def count_subdomains(problem: Problem[Any], schwarz: Schwarz) -> int:
    """The number of subdomains of a descent.

    Raises :class:`~equimesh.errors.InputError` for settings of equidistribution, for groups or rectangles that do not
    fit the domain, for straight lines, and for values of another solver.
    """
    if isinstance(problem.monitor, NodalSolution):
        raise InputError(NO_ROUNDS, field="schwarz")
    descent = problem.monitor if isinstance(problem.monitor, LeastError) else None
    if descent and descent.purpose != "interpolation":
        raise InputError(NO_SOLVERS_PARTS, field="monitor.purpose")
    if in_blocks(problem):
        schwarz.require_blocks()
        return int(owners(schwarz, problem.domain.mesh).max()) + 1
    schwarz.require_descent()
    if descent and descent.rectilinear:
        raise InputError(NO_STRAIGHT_LINES, field="monitor.rectilinear")
    return int(schwarz.owner_of_cells(problem.grid).max()) + 1


def _compared(solution: AnySolution, comparison: tuple[Candidate, ...]) -> AnySolution:
    """The solution with the candidates among which its monitor was chosen; what was measured stays known."""
    found = replace(solution, comparison=comparison)
    vars(found).update({name: value for name, value in vars(solution).items() if name not in vars(found)})
    return found


def _is_no_worse(solution: AnySolution, auto: Auto, found: Choice) -> bool:
    """Whether the mesh is no worse than the uniform one: for interpolation, and for a solver that it is meant for."""
    if not auto.compares_solvers or not is_no_worse(solution, auto.norm):
        return is_no_worse(solution, auto.norm)
    compared = found.chosen.mesh
    if compared is not None and np.array_equal(compared.points, solution.mesh.points):
        return not found.chosen.solver < 1.0
    gain = solution.solver_gain
    return gain is None or not gain[auto.norm] < 1.0


# What is refused before any work.


def _without_mesh(initial: AnyStart) -> Initial:
    """The start of a further solve: nested in place of a mesh that was given."""
    return initial if isinstance(initial, Initial) else Initial.NESTED


def _check_arguments(problem: object, schwarz: object) -> None:
    """Refuse arguments of other types, with what to give."""
    if not isinstance(problem, Problem):
        raise InputError(
            f"problem = {str(problem)[:40]!r} is no problem: give"
            " Problem(monitor=Auto(u=Expression('...')), grid=Grid(n_xi=33, n_eta=33))",
            field="problem",
        )
    if schwarz is not None and not isinstance(schwarz, Schwarz):
        raise InputError(
            f"schwarz = {str(schwarz)[:40]!r} are no settings of a Schwarz iteration: give Schwarz(subdomains=(2, 1)),"
            " or None for a single domain",
            field="schwarz",
        )


def checked_start(problem: Problem[Any], initial: AnyStart) -> AnyStart:
    """The start of a solve.

    Raises :class:`~equimesh.errors.InputError` for a mesh of another grid or domain, for a folded one, and for a grid
    that is too coarse for its domain.
    """
    if in_blocks(problem):
        return check_start_on_blocks(problem.domain, initial)
    if isinstance(initial, Mesh) and not initial.is_grid:
        message = "initial is a mesh of blocks, and the problem has a grid: give a mesh of the reference square"
        raise InputError(message, field="initial")
    start = initial if isinstance(initial, Mesh) else choice(Initial, initial, "initial")
    if isinstance(start, Mesh):
        _check_mesh(problem, start)
    if type(problem.domain) is not Rectangle and map_mesh(Mesh.uniform(problem.grid), problem.domain).is_folded:
        raise InputError(
            f"the uniform mesh of {problem.grid} points has an inverted cell on this domain: its sides curve too much"
            " for so few points; add grid points",
            field="grid",
        )
    return start


def check_start_on_blocks(domain: Blocks, initial: AnyStart) -> Initial | Mesh:
    """The start of a solve on blocks; raises as :func:`checked_start`."""
    if not isinstance(initial, Mesh):
        return choice(Initial, initial, "initial")
    if initial.is_grid:
        raise InputError("initial is the mesh of a grid: give a mesh of the domain in blocks", field="initial")
    own = domain.mesh
    if initial.points.shape != own.points.shape or not np.array_equal(initial.cells, own.cells):
        raise InputError(
            f"the mesh to start from has {len(initial.points)} points, the domain {len(own.points)}: give a mesh with"
            " the cells of the domain, such as that of a solution on it",
            field="initial",
        )
    if initial.is_folded:
        raise InputError("the mesh to start from has an inverted cell: give a valid one", field="initial")
    return initial


def _is_near(problem: Problem, start: Mesh) -> bool:
    return deviation(problem.metric, problem.boundary, start) <= MAX_START_DEVIATION


def _sides(problem: Problem, start: Mesh) -> Iterator[Array]:
    """The distances of nodes from the sides of the reference square, or from the other copy of a seam."""
    along_xi, along_eta = closed_of(problem.domain)
    for closed, along, across in ((along_xi, start.x, start.y), (along_eta, start.y.T, start.x.T)):
        yield from (along[-1] - along[0] - 1.0, across[-1] - across[0]) if closed else (along[0], along[-1] - 1.0)


def _check_mesh(problem: Problem, start: Mesh) -> None:
    if start.x.shape != problem.grid.shape:
        raise InputError(f"the mesh to start from has {start.grid} points, the grid {problem.grid}", field="initial")
    # Where lines are curved, a valid mesh of the domain can have a reference with folded cells.
    is_folded = start.is_folded and map_mesh(start, problem.domain).is_folded
    if is_folded or any(np.any(np.abs(side) > smallest_tolerance(problem)) for side in _sides(problem, start)):
        raise InputError(
            "the mesh to start from must be a valid one of the reference square: give the reference of a solution",
            field="initial",
        )
