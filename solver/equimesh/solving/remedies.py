"""Remedies after a solve that did not reach the requested mesh."""

import math
from dataclasses import replace

from equimesh.equations.boundary import Boundary
from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.errors import DecompositionError
from equimesh.monitors.arc_length import ArcLength
from equimesh.schwarz.conditions import Optimized, label
from equimesh.schwarz.records import IterationNumbers
from equimesh.schwarz.settings import Acceleration, Schwarz

# More iterations than this are not suggested.
MAX_SUGGESTED_ITERATIONS = 1000
# From fewer iterations than this the number of those still needed cannot be predicted.
MIN_RECORDED_ITERATIONS = 5


def after_newton(problem: Problem, *, nested: bool, reached: float = 1.0) -> str:
    """The remedy where no valid mesh was found; continuation ``reached`` this strength of the monitor."""
    if reached == 0.0:
        return _sentence(
            "replace a jump of u, or a change too fast for this grid, by a steep tanh",
            *_weaker(problem, reached),
            *_settings(problem, nested=nested),
        )
    return _sentence(*_weaker(problem, reached), "add grid points", *_settings(problem, nested=nested))


def _weaker(problem: Problem, reached: float) -> list[str]:
    """Ways to request less adaptation."""
    monitor = problem.monitor
    if isinstance(monitor, ArcLength):
        lower = f"lower a to {reached * monitor.a:.2g} or less" if 0.0 < reached < 1.0 else "lower a"
        return [lower, "raise b", "smooth the monitor"]
    return ["smooth the monitor"]


def after_rounding() -> str:
    """The remedy where rounding errors of u are as large as its variation over a cell."""
    return _sentence("subtract a constant from u, so that its values are not much larger than it varies")


def after_mapping() -> str:
    """The remedy for a valid mesh of the reference square that folds on the domain."""
    return _sentence("add grid points: the sides curve too much for this grid")


def after_folding(problem: Problem, schwarz: Schwarz | None, *, nested: bool) -> str:
    """The remedy for a solve that ended with an inverted cell."""
    more = ["run more iterations"] if schwarz is not None and schwarz.tolerance is None else []
    return _sentence(*more, *_weaker(problem, 1.0), *_settings(problem, nested=nested))


def after_schwarz(
    problem: Problem, schwarz: Schwarz, last: IterationNumbers, rate: float | None, tolerance: float
) -> str:
    """The remedy for a Schwarz iteration that did not reach its ``tolerance``.

    ``rate`` is the observed rate, or the predicted one if that is slower.
    """
    ideas = []
    left = max(last.estimate, last.mismatch / 2) / max(tolerance, smallest_tolerance(problem))
    if rate is None or last.iteration < MIN_RECORDED_ITERATIONS:
        ideas.append("allow more iterations")
    elif 0.0 < rate < 1.0 and 1.0 < left < math.inf:
        more = math.ceil(math.log(left) / -math.log(rate)) + 1
        if more <= MAX_SUGGESTED_ITERATIONS:
            ideas.append(f"allow more iterations (about {more} more at the observed rate of {rate:.2g})")
    wider = 2 * schwarz.overlap
    if _fits(problem, schwarz, wider):
        ideas.append(f"widen the overlap, to {wider} points for instance")
    if last.transmission != label(Optimized()):
        ideas.append("use the optimized transmission condition")
    if not schwarz.line_corrections and schwarz.accelerated_by is not Acceleration.NEWTON:
        ideas.append("allow line corrections, 3 for instance")
    return _sentence(*ideas, "solve as a single domain")


def _settings(problem: Problem, *, nested: bool) -> list[str]:
    ideas = [] if nested else ["start nested"]
    return ideas if problem.boundary is Boundary.TRACE else [*ideas, "use the trace boundary condition"]


def _fits(problem: Problem, schwarz: Schwarz, overlap: int) -> bool:
    try:
        replace(schwarz, overlap=overlap).decompose(problem.grid)
    except DecompositionError:
        return False
    return True


def _sentence(*ideas: str) -> str:
    listed = ", or ".join([", ".join(ideas[:-1]), ideas[-1]]) if len(ideas) > 1 else ideas[0]
    return listed[0].upper() + listed[1:] + "."
