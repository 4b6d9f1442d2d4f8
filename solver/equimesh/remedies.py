"""What to try after a solve that failed: only what that solve had not tried yet."""

from __future__ import annotations

import math
from dataclasses import replace

from equimesh.boundary import Boundary
from equimesh.errors import DecompositionError
from equimesh.problem import Problem
from equimesh.schwarz import Iteration, Schwarz, smallest_tolerance
from equimesh.single_domain import FINEST_CONTINUATION
from equimesh.transmission import Classical

# More iterations than this are no remedy to offer, and from fewer than these no number can be foretold.
MOST_OFFERED, FEWEST_SEEN = 1000, 5


def after_newton(problem: Problem, *, nested: bool, reached: float | None = None) -> str:
    """For a Newton iteration that found no mesh; ``reached`` is the ``a`` to which continuation came."""
    if reached == 0.0:
        return _sentence(
            "replace a jump of u, or a change too fast for this grid, by a steep tanh",
            *_points(problem, nested=nested),
            *_settings(problem, nested=nested),
        )
    lower = f"lower a to {reached:.2g} or less" if reached is not None and reached < problem.monitor.a else "lower a"
    return _sentence(lower, "raise b", *_points(problem, nested=nested), *_settings(problem, nested=nested))


def after_folding(problem: Problem, schwarz: Schwarz | None, *, nested: bool) -> str:
    """For a solve that ended with an inverted cell."""
    more = ["run more iterations"] if schwarz is not None and schwarz.tolerance is None else []
    return _sentence(*more, "lower a", "raise b", *_settings(problem, nested=nested))


def after_schwarz(problem: Problem, schwarz: Schwarz, last: Iteration, rate: float | None, *, rescued: bool) -> str:
    """For a Schwarz iteration that did not reach its tolerance; ``rate`` is the observed one."""
    ideas = []
    left = max(last.estimate, last.mismatch / 2) / max(schwarz.tolerance or 0.0, smallest_tolerance(problem.grid))
    if rate is None or last.iteration < FEWEST_SEEN:
        ideas.append("allow more iterations")
    elif 0.0 < rate < 1.0 and 1.0 < left < math.inf:
        more = math.ceil(math.log(left) / -math.log(rate)) + 1
        if more <= MOST_OFFERED:
            ideas.append(f"allow more iterations (about {more} more at the observed rate of {rate:.2g})")
    wider = 2 * schwarz.overlap
    if _fits(problem, schwarz, wider):
        ideas.append(f"widen the overlap, to {wider} points for instance")
    if isinstance(schwarz.transmission, Classical):
        ideas.append("use a Robin transmission condition with p = auto")
    elif rescued:
        ideas.append("use the classical transmission condition")
    elif getattr(schwarz.transmission, "p", "auto") != "auto":
        ideas.append("use p = auto")
    return _sentence(*ideas, "solve as a single domain")


def _points(problem: Problem, *, nested: bool) -> list[str]:
    """A nested solve fails on its way to a finer grid, whatever the points of that."""
    return ["add grid points"] if not nested or max(problem.grid.shape) < FINEST_CONTINUATION else []


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
