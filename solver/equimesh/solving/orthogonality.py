"""Meshes whose angles of non-orthogonality have a bound: a weaker monitor, or more regular cells, until it holds.

The angle is that of :mod:`equimesh.quality.faces`, on the mesh of the domain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.least_error import MAX_WEIGHT, LeastError
from equimesh.monitors.metrics import ArcLength
from equimesh.monitors.monitor import orthogonality_of
from equimesh.quality.faces import measure_faces
from equimesh.solving.solution import AnySolution
from equimesh.solving.status import Status
from equimesh_schema import Relaxed

MAX_TRIALS = 8
"""Weaker monitors that are tried."""
ENOUGH_SHARE = 0.9
"""The share of the bound from which on an angle is near enough to it."""
MIN_STEP, MAX_STEP = 0.2, 0.85
"""The next strength lies at least and at most at these shares of the way between two known ones."""
FACTORS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0, 2048.0)
"""Factors of ``distortion`` and ``smoothness`` that are tried, as far as the two may be so large."""

OBLIQUENESS_TRIALS = ((10.0, 1.0), (100.0, 1.0), (1000.0, 1.0), (100.0, 4.0), (100.0, 16.0), (100.0, 64.0))
"""Weights of oblique corners on blocks, each with a factor of distortion and smoothness, until the bound holds."""


class Corners(NamedTuple):
    """The angle of corners, in degrees, below which few of them should be, and the weight of those near and beyond."""

    smallest_angle: float
    obliqueness: float


Again: TypeAlias = Callable[[Problem[Any], Corners | None], AnySolution]
"""Solves a problem as the first one was solved, without a look at the bound; on blocks with the weight of corners."""


def require_possible(problem: Problem) -> None:
    """Raises :class:`~equimesh.errors.InputError` where the uniform mesh of the domain has a larger angle than asked.

    Meshes of weak monitors are near the uniform one.
    """
    bound = orthogonality_of(problem.monitor)
    if bound is None:
        return
    angle = measure_faces(problem.initial).non_orthogonality
    if angle > bound:
        raise InputError(
            f"orthogonality = {bound:g}: the uniform mesh of {problem.grid} points has an angle of {angle:.4g} degrees"
            f" on this domain already; raise the bound to {math.ceil(angle)} or more, or take another domain",
            field="monitor.orthogonality",
        )


def is_within(solution: AnySolution) -> bool:
    """Whether the largest angle of the mesh is at most the bound of its monitor, or there is no bound."""
    bound = orthogonality_of(solution.problem.monitor)
    return bound is None or solution.faces.non_orthogonality <= bound


def bounded(solution: AnySolution, again: Again) -> AnySolution:
    """The solution if it is within its bound, otherwise the solution of a request that is weakened until it is.

    The certificate says how much the request is weakened.
    """
    if is_within(solution):
        return solution
    if not isinstance(solution.problem.monitor, LeastError):
        return _weaker(solution, again)
    return _with_wide_corners(solution, again) if in_blocks(solution.problem) else _more_regular(solution, again)


def bounded_round(solution: AnySolution, again: Again) -> AnySolution:
    """The solution of a round if it is within its bound, otherwise that of the least error of the same values.

    A round has no weights that could be raised: its least-error mesh has.
    """
    if is_within(solution):
        return solution
    problem: Problem[Any] = solution.problem
    monitor: Any = problem.monitor
    free = again(replace(problem, monitor=monitor.least_error), None)
    found = bounded(free, again)
    told = found if found.detours else _told(found, problem, "replaced the round by one least-error mesh", ())
    return replace(told, problem=problem, estimate=solution.estimate, comparison=solution.comparison)


def _with_wide_corners(solution: AnySolution, again: Again) -> AnySolution:
    """The first mesh of blocks within its bound, with oblique corners dearer and dearer.

    Where the initial mesh has a larger angle than the bound, that angle is the bound: no face is more oblique than the
    most oblique one of the initial mesh, and corners are weighed as for the bound. Where no weight of oblique corners
    is enough, distortion and smoothness are raised, too. The initial mesh where nothing is.
    """
    problem: Problem[Any] = solution.problem
    monitor: Any = problem.monitor
    asked: float = monitor.orthogonality
    initial = measure_faces(solution.initial).non_orthogonality
    bound, before = max(asked, initial), ""
    if initial > asked:
        before = f"The initial mesh has an angle of {initial:.4g} degrees, which is the bound in place of {asked:g}. "
    for obliqueness, factor in OBLIQUENESS_TRIALS:
        raised = replace(problem, monitor=replace(monitor, **_raised(monitor, factor)))
        tried = again(raised, Corners(90.0 - asked, obliqueness))
        if tried.status.succeeded and tried.faces.non_orthogonality <= bound:
            detour = f"The bound of {asked:g} degrees of non-orthogonality gave oblique corners the weight"
            detour = f"{before}{detour} {obliqueness:g}"
            detour += "." if factor == 1.0 else f", and raised distortion and smoothness by the factor {factor:g}."
            note = f"{detour} {tried.note}".strip()
            return replace(tried, problem=problem, detours=(*tried.detours, detour), note=note)
    detour = f"{before}The bound of {asked:g} degrees of non-orthogonality left no mesh but the initial one."
    kept = Relaxed(what="strength", asked=1, reached=0)
    return replace(
        solution, mesh=solution.initial, reference=solution.initial, relaxed=(kept,), detours=(detour,), note=detour
    )


def _raised(monitor: LeastError, factor: float) -> dict[str, float]:
    """``distortion`` and ``smoothness``, raised by a factor as far as the two may be so large."""
    return {name: min(MAX_WEIGHT, factor * getattr(monitor, name)) for name in ("distortion", "smoothness")}


def _more_regular(solution: AnySolution, again: Again) -> AnySolution:
    """The mesh of least error with larger weights of distortion and smoothness, or of straight lines if that is better.

    The weights are the smallest of ``FACTORS`` for which the bound holds. The uniform mesh where none does.
    """
    problem: Problem[Any] = solution.problem
    monitor: Any = problem.monitor
    found: list[AnySolution] = []
    too_low, enough = -1, len(FACTORS)
    while enough - too_low > 1:
        middle = min((too_low + enough) // 2, len(FACTORS) - 1)
        raised = _raised(monitor, FACTORS[middle])
        tried = again(replace(problem, monitor=replace(monitor, **raised)), None)
        if is_within(tried) and tried.status.succeeded:
            relaxed = tuple(Relaxed(what=n, asked=getattr(monitor, n), reached=value) for n, value in raised.items())
            weights = " and ".join(f"{name} = {value:g}" for name, value in raised.items())
            found = [_told(tried, problem, f"raised the weights to {weights}", relaxed)]
            enough = middle
        else:
            too_low = middle
    if not monitor.rectilinear:
        straight = again(replace(problem, monitor=replace(monitor, rectilinear=True)), None)
        if is_within(straight) and straight.status.succeeded:
            relaxed = (Relaxed(what="rectilinear", asked=0.0, reached=1.0),)
            found.append(_told(straight, problem, "kept all lines straight", relaxed))
    errors = [(_error(one), one) for one in found]
    return min(errors, key=lambda pair: pair[0])[1] if errors else _on_uniform(solution, Status.COMPLETED)


def _weaker(solution: AnySolution, again: Again) -> AnySolution:
    """The mesh of the strongest monitor that was found within the bound; the uniform mesh where none is."""
    problem, bound = solution.problem, orthogonality_of(solution.problem.monitor)
    if bound is None or not solution.status.succeeded:
        return solution
    best, low, high = None, 0.0, 1.0
    at_low, at_high = measure_faces(problem.initial).non_orthogonality, solution.faces.non_orthogonality
    for _ in range(MAX_TRIALS):
        rise = (0.97 * bound - at_low) / (at_high - at_low) if at_high > at_low else 0.5
        strength = low + (high - low) * min(max(rise, MIN_STEP), MAX_STEP)
        tried = again(replace(problem, monitor=problem.monitor.weakened(strength)), None)
        angle = tried.faces.non_orthogonality
        if tried.status.succeeded and angle <= bound:
            best, low, at_low = _of_strength(tried, problem, strength), strength, angle
            if angle >= ENOUGH_SHARE * bound:
                break
        else:
            high, at_high = strength, angle if math.isfinite(angle) else at_high
    return _on_uniform(solution, Status.RELAXED) if best is None else best


def _of_strength(tried: AnySolution, problem: Problem, strength: float) -> AnySolution:
    """The solution for a weaker monitor, as one of the requested problem that is relaxed."""
    what, asked = ("a", problem.monitor.a) if isinstance(problem.monitor, ArcLength) else ("strength", 1.0)
    inner = next((one.reached / one.asked for one in tried.relaxed if one.what == what and one.asked), 1.0)
    rest = [one for one in tried.relaxed if one.what != what]
    relaxed = (Relaxed(what=what, asked=asked, reached=inner * strength * asked), *rest)
    told = _told(tried, problem, f"lowered the strength of the monitor to {strength:.3g}", relaxed)
    return replace(told, status=Status.RELAXED)


def _on_uniform(solution: AnySolution, status: Status) -> AnySolution:
    problem = solution.problem
    uniform = replace(
        solution, mesh=solution.initial, reference=Mesh.uniform(problem.grid), status=status, algebraic_error=None
    )
    uniform = replace(uniform, discretization_error=None)
    return _told(uniform, problem, "left no mesh but the uniform one", (Relaxed(what="strength", asked=1, reached=0),))


def _told(solution: AnySolution, problem: Problem, what: str, relaxed: Iterable[Relaxed]) -> AnySolution:
    """The solution as one of the requested ``problem``, with what the bound has changed."""
    detour = f"The bound of {orthogonality_of(problem.monitor):g} degrees of non-orthogonality {what}."
    return replace(
        solution,
        problem=problem,
        relaxed=tuple(relaxed),
        detours=(*solution.detours, detour),
        note=f"{detour} {solution.note}".strip(),
    )


def _error(solution: AnySolution) -> float:
    """The interpolation error of u in the norm of the monitor."""
    errors, monitor = solution.interpolation, solution.problem.monitor
    if errors is None:
        return math.inf
    return errors.h1 if isinstance(monitor, LeastError) and monitor.norm == "h1" else errors.l2
