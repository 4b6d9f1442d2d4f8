"""How a solve is requested, how it ends, and what helps where it fails."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from difflib import get_close_matches
from enum import StrEnum
from typing import TypedDict, TypeVar

from equimesh.equations.boundary import Boundary
from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.errors import DecompositionError
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.schwarz.conditions import Optimized, label
from equimesh.schwarz.records import IterationNumbers
from equimesh.schwarz.settings import Acceleration, Schwarz
from equimesh.single_domain.steps import Mode
from equimesh.solving.progress import Announcer, Course, Event, Observer

# Options of one solve that do not belong to its problem.

_E = TypeVar("_E", bound=Event)


class Initial(StrEnum):
    """The start of a solve: ``NESTED``, the solution on a grid half as fine; ``UNIFORM``, the uniform mesh."""

    NESTED = "nested"
    UNIFORM = "uniform"


class SolveArguments(TypedDict, total=False):
    """Options of :func:`~equimesh.solving.solve.solve`. Each of them may be left out."""

    initial: Initial | Mesh | QuadMesh
    """The start: nested (default), uniform, or a mesh of the reference square, such as the ``reference`` of the
    solution for a monitor a time step earlier. Where such a mesh is far from the solution, the start is nested. On a
    domain in blocks a mesh of the domain, such as the ``mesh`` of a solution.
    """
    mode: Mode
    """When a single-domain solve ends. Default: at the error of the grid. A Schwarz iteration has its own tolerance."""
    allow_relaxed: bool
    """Whether a mesh of relaxed equations is accepted where no valid mesh satisfies the requested ones. Default: True.
    Its status is ``RELAXED``, and its certificate lists what was relaxed.
    """
    threads: int | None
    """How many threads share the work on large grids; the mesh does not depend on it. Default: None, one a core."""
    observe: Observer | None
    """Called with every step of a single-domain solve, also that of a nested start, with every Schwarz iteration, and
    with every step of descent; with an ``Auto`` monitor also of the candidates on coarse grids. Every record has
    ``fraction``, the share of the work that is done, and ``phase``, what is being done in words. Default: None.
    """
    check: bool
    """Whether a solve without the requested mesh raises. Default: True. With False, its status reports the failure."""


DEFAULTS: SolveArguments = {
    "initial": Initial.NESTED,
    "mode": Mode.DISCRETIZATION,
    "allow_relaxed": True,
    "threads": None,
    "observe": None,
    "check": True,
}
"""The values of options that are not given."""


def complete_arguments(arguments: SolveArguments) -> SolveArguments:
    """All options of a solve: the given ones, and the defaults of the others.

    Raises :class:`TypeError` for an option that does not exist; the message names the nearest one.
    """
    unknown = [name for name in arguments if name not in DEFAULTS]
    if unknown:
        nearest = get_close_matches(unknown[0], ["problem", "schwarz", *DEFAULTS], n=1)
        advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(DEFAULTS)}"
        raise TypeError(f"solve() has no option {unknown[0]!r}; {advice}")
    return {**DEFAULTS, **arguments}


@dataclass(frozen=True)
class SolveOptions:
    """The options that a single-domain and a Schwarz solve share, checked."""

    mode: Mode
    """When a single-domain solve ends."""
    allow_relaxed: bool
    """Whether a mesh of relaxed equations is a success."""
    threads: int
    """How many threads share the work."""
    observer: Announcer | None
    """Called with every step and iteration."""

    def observe(self, event: _E) -> _E:
        """Hand a record to the observer, if there is one; returns the record with what the observer was told."""
        return event if self.observer is None else self.observer.announce(event)

    def part(
        self, begin: float | None = 0.0, end: float | None = 1.0, doing: str = "", course: Course | None = None
    ) -> SolveOptions:
        """The options for a part of the work, as :meth:`~equimesh.solving.progress.Announcer.part`."""
        return self if self.observer is None else replace(self, observer=self.observer.part(begin, end, doing, course))


class Status(StrEnum):
    """The end of a solve. :attr:`sentence` describes it.

    A folded mesh never counts as one of the first three.
    """

    CONVERGED = "converged"
    """The mesh satisfies the equations to the tolerance: success."""
    RELAXED = "relaxed"
    """The mesh is valid and satisfies weaker equations, which the certificate lists: success, if allowed."""
    COMPLETED = "completed"
    """All steps were taken, without a tolerance to meet: those of a Schwarz iteration, or of a descent. Success."""
    NOT_CONVERGED = "not_converged"
    """A Schwarz iteration reached its limit of iterations before its tolerance."""
    NEWTON_FAILED = "newton_failed"
    """The solve stalled, also with relaxed equations, or these were not allowed."""
    FOLDED = "folded"
    """The solve ended, but its mesh has an inverted cell on the domain."""

    @property
    def succeeded(self) -> bool:
        """Whether the mesh is the requested one, or an allowed approximation of it."""
        return self in (Status.CONVERGED, Status.RELAXED, Status.COMPLETED)

    @property
    def sentence(self) -> str:
        """The status in a sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.CONVERGED: "The mesh satisfies the equidistribution equations to the requested tolerance.",
    Status.RELAXED: "The mesh is valid, but solves weaker equations: those requested had no valid mesh within bounds.",
    Status.COMPLETED: "The mesh is finished: all its steps were taken.",
    Status.NOT_CONVERGED: "The Schwarz iteration did not reach its tolerance within the allowed iterations.",
    Status.NEWTON_FAILED: "No valid mesh was found that satisfies the requested equations.",
    Status.FOLDED: "The mesh has an inverted cell.",
}


# Remedies after a solve that did not reach the requested mesh.

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
