"""One call from a problem to its mesh: by a single-domain solve, a Schwarz iteration, or a descent."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Unpack, overload

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Rectangle, closed_of, is_closed, map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, smallest_tolerance
from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.least_error.iteration import DescentEnd
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.monitor import map_of, require_lines
from equimesh.numerics.channel import thread_count
from equimesh.numerics.types import Array
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.auto import choose_monitor, comparison_share, solve_for_finite_volumes
from equimesh.solving.blocks import EQUIDISTRIBUTION_ONLY, blocks_method
from equimesh.solving.least_error import is_no_worse, solve_least_error, solve_round
from equimesh.solving.orthogonality import bounded, require_possible
from equimesh.solving.schwarz import solve_by_schwarz
from equimesh.solving.single_domain import (
    is_lost_in_rounding,
    require_open,
    solution_lost_in_rounding,
    solve_single_domain,
)
from equimesh.solving.solution import AnySolution, OnBlocks, Solution, SolveError
from equimesh.solving.status import Announcer, Initial, SolveArguments, SolveOptions, complete_arguments
from equimesh.sweeps.deviation import deviation

# Largest deviation of squared metric lengths from the mean of their line, as a share of it, at which a given mesh is
# near enough to start from: a front may have moved by half a cell.
MAX_START_DEVIATION = 0.25
NO_SUBDOMAINS = (
    "a least-error mesh minimises one integral over all cells, and its nodes satisfy no equations that subdomains could"
    " exchange: leave the Schwarz settings out, or take the curvature or the arc-length monitor"
)
"""The reason why least error with Schwarz settings is refused."""
NO_BLOCKS = "initial is a mesh of blocks, and the problem has a grid: give a mesh of the reference square"
"""The reason why a mesh of blocks is refused as the start of a grid."""


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

    An equidistributed mesh is found by Schwarz iteration if ``schwarz`` is given, else on the whole grid. The mesh of a
    domain in blocks is one of least error, with ``schwarz`` by an iteration between its blocks.

    ``options`` are the keys of :class:`~equimesh.solving.status.SolveArguments`: ``initial``, ``mode``,
    ``allow_relaxed``, ``threads``, ``observe`` and ``check``.

    Raises :class:`~equimesh.solving.solution.SolveError`, which carries the partial solution, when the mesh is not the
    requested one; with ``check=False`` the status reports it instead. A folded mesh is never a success. Raises
    :class:`~equimesh.errors.InputError` for values of options that cannot be used, and :class:`TypeError` for an option
    that does not exist.
    """
    _check_arguments(problem, schwarz)
    arguments = complete_arguments(options)
    checked = SolveOptions(
        mode=choice(Mode, arguments["mode"], "mode"),
        allow_relaxed=arguments["allow_relaxed"],
        threads=thread_count(arguments["threads"]),
        observer=Announcer.of(arguments["observe"]),
    )
    given = {name for name in EQUIDISTRIBUTION_ONLY if name in options}
    method: Callable[[SolveOptions], AnySolution]
    if in_blocks(problem):
        method = blocks_method(problem, schwarz, arguments["initial"], given)
    else:
        method = _grid_method(problem, schwarz, arguments["initial"])
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        solution = method(checked)
    if arguments["check"] and not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


def _grid_method(
    problem: Problem, schwarz: Schwarz | None, initial: Initial | Mesh | QuadMesh
) -> Callable[[SolveOptions], Solution]:
    """The function that solves a problem on a grid. Raises for problems that it cannot solve."""
    if schwarz is not None:
        schwarz.require_grid()
    if isinstance(initial, QuadMesh):
        raise InputError(NO_BLOCKS, field="initial")
    start = initial if isinstance(initial, Mesh) else choice(Initial, initial, "initial")
    _check_start(problem, start)
    require_possible(problem)
    _check_ways(problem, schwarz)
    solve_it = _solve_chosen if isinstance(problem.monitor, Auto) else _solve
    return lambda options: solve_it(problem, schwarz, start, options)


def _solve_chosen(
    problem: Problem, schwarz: Schwarz | None, initial: Initial | Mesh, options: SolveOptions
) -> Solution:
    """The solution for the best monitor; of least error where the mesh of another one turns out to be worse.

    From a given mesh the error is minimised without a comparison, which would take longer than that.
    """
    auto = problem.monitor
    if not isinstance(auto, Auto):
        raise TypeError("only an Auto monitor is chosen")
    if auto.purpose == "finite_volume":

        def single(candidate: Problem, part: SolveOptions) -> Solution:
            return _solve_once(candidate, None, Initial.NESTED, part)

        def final(candidate: Problem, part: SolveOptions) -> Solution:
            return _solve_once(candidate, schwarz, initial, part)

        return solve_for_finite_volumes(problem, options, single, None if schwarz is None else final)
    if isinstance(initial, Mesh) and schwarz is None:  # the mesh before was chosen, or is as good a start as any
        return _solve(replace(problem, monitor=auto.least_error()), None, initial, options)
    share = comparison_share(problem.grid) if schwarz is None else None
    choice = choose_monitor(problem, options.part(0.0, share), metrics_only=schwarz is not None)
    solution, rest = None, options.part(share if schwarz is None else 0.0)
    while solution is None or not is_no_worse(solution, auto.norm):
        chosen = replace(problem, monitor=choice.chosen.monitor)
        solution = _solve(chosen, schwarz, initial, rest, choice.chosen.coarse)
        rest = options.part(None, doing="another monitor")
        solution = replace(solution, comparison=choice.comparison)
        if choice.least_error is None:
            break
        choice = choice.least_error
    return solution


def _solve(
    problem: Problem,
    schwarz: Schwarz | None,
    initial: Initial | Mesh,
    options: SolveOptions,
    coarse: DescentEnd | None = None,
) -> Solution:
    """The solution by the way that belongs to the monitor and the settings, within the bound of its angles."""

    def again(weaker: Problem) -> Solution:
        telling = options.part(None, doing="for smaller angles")
        return _solve_once(weaker, schwarz, Initial.NESTED if isinstance(initial, Mesh) else initial, telling)

    return bounded(_solve_once(problem, schwarz, initial, options, coarse), again)


def _solve_once(
    problem: Problem,
    schwarz: Schwarz | None,
    initial: Initial | Mesh,
    options: SolveOptions,
    coarse: DescentEnd | None = None,
) -> Solution:
    """The solution by the way that belongs to the monitor and the settings."""
    if isinstance(problem.monitor, NodalSolution):
        return solve_round(problem, options.threads)
    if isinstance(problem.monitor, LeastError):
        return replace(solve_least_error(problem, initial, options, coarse), threads=options.threads)
    starts = map_of(problem.monitor) == "lines"  # a gradient map has no use for a mesh to start from
    is_far = isinstance(initial, Mesh) and starts and (initial.is_folded or not _is_near(problem, initial))
    initial = Initial.NESTED if is_far else initial
    if is_lost_in_rounding(problem):
        solution = solution_lost_in_rounding(problem, schwarz, options.mode)
    elif schwarz is None:
        solution = solve_single_domain(problem, initial, options)
    else:
        solution = solve_by_schwarz(problem, schwarz, initial, options)
    if is_far:
        detour = "The given mesh is too far from the solution to start from; the start was nested."
        note = f"{detour} {solution.note}".strip()
        solution = replace(solution, detours=(detour, *solution.detours), note=note)
    return replace(solution, threads=options.threads)


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


def _check_ways(problem: Problem, schwarz: Schwarz | None) -> None:
    """Refuse a monitor that subdomains cannot solve."""
    if schwarz is not None and isinstance(problem.monitor, NodalSolution | LeastError):
        raise InputError(NO_SUBDOMAINS, field="schwarz")
    if schwarz is not None:
        require_lines(problem.monitor)
    require_open(problem, schwarz)


def _check_start(problem: Problem, initial: Initial | Mesh) -> None:
    """Refuse a grid that is too coarse for its domain or too fine for its start, and a start on another grid."""
    if isinstance(initial, Mesh):
        _check_mesh(problem, initial)
    if (
        initial is Initial.UNIFORM
        and not is_closed(problem.domain)
        and not isinstance(problem.monitor, NodalSolution | LeastError)
        and problem.grid.points > MAX_FACTORISED_POINTS
    ):
        raise InputError(
            f"a start from the uniform mesh takes Newton's method, on at most {MAX_FACTORISED_POINTS} points;"
            f" {problem.grid} are more: start nested",
            field="initial",
        )
    if type(problem.domain) is not Rectangle and map_mesh(Mesh.uniform(problem.grid), problem.domain).is_folded:
        raise InputError(
            f"the uniform mesh of {problem.grid} points has an inverted cell on this domain: its sides curve too much"
            " for so few points; add grid points",
            field="grid",
        )


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
