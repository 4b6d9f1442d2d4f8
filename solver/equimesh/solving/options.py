"""Options of one solve that do not belong to its problem."""

from dataclasses import dataclass, replace
from difflib import get_close_matches
from enum import StrEnum
from typing import TypedDict, TypeVar

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.single_domain.steps import Mode
from equimesh.solving.announcer import Announcer, Course, Event, Observer

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
    ) -> "SolveOptions":
        """The options for a part of the work, as :meth:`~equimesh.solving.announcer.Announcer.part`."""
        return self if self.observer is None else replace(self, observer=self.observer.part(begin, end, doing, course))
