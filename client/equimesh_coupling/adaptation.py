"""A loop that adapts a mesh to the solution of a solver: its records, its decisions, and the wanted density."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from inspect import signature
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np

from equimesh_coupling.display import draw_on, error_of_cells, picture_of_values
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array
from equimesh_schema.notebook import html_of

MIN_FALL: Final = {"l2": 0.15, "h1": 0.08}
"""The share by which the estimate has to fall below the best one before, for a round to count.

The error of the gradient falls with the spacing, that of u with its square.
"""
PATIENCE = 2
"""Rounds in a row without that fall after which the loop ends."""
MAX_UNRESOLVED_SHARE = 0.15
"""The largest share of the gradient that a mesh may leave unresolved. A layer within one cell leaves 0.2 to 0.4."""
MIN_TOTAL_FALL = 2.0
"""Where that share is not known: the least factor by which the estimate has to fall in all while the mesh moves."""
MAX_REST_CELLS = 1.0
"""Moves of the nodes, in spacings, that count as rest."""
DOUBT_FACTORS: Final = {True: 2.0, False: 8.0}
"""How many times the squared estimate is taken off a squared gradient, of a mesh that resolves it and of another one.

Nodal values have a gradient that is wrong by about their error. Where nothing is resolved it may be an oscillation: a
zigzag from node to node, which says nothing of u, has a squared gradient of 5 times its squared estimate.
"""
MIN_UNSEEN = 0.01
"""The least share of the squared gradient that counts as not seen. Boundary values alone make small differences."""


@dataclass(frozen=True, kw_only=True)
class GoalRecord:
    """The functional of one round."""

    value: float
    """The functional of the solution on this mesh."""
    error: float | None
    """The estimate of what it lacks of the functional of the exact solution, with its sign; ``None``: not known."""
    bound: float
    """The sum over the cells of the products of the estimated errors of the gradients of u and z."""

    @property
    def corrected(self) -> float:
        """The value with its estimated error added."""
        return self.value + (self.error or 0.0)

    @property
    def largest_error(self) -> float:
        """The bound, or the estimated error where it exceeds that: values given on sides count in it, too."""
        return max(self.bound, abs(self.error or 0.0))


@dataclass(frozen=True, kw_only=True)
class RoundNumbers:
    """Estimates of the solution on the mesh of one round; round 0 is the first mesh."""

    estimate: float
    """The estimated L2 error of the solution on its own mesh, or what an indicator sums up to."""
    estimate_h1: float | None = None
    """The estimated error of the gradient on the same mesh; ``None`` where it is not known."""
    unresolved: float | None = None
    """The estimated error of the gradient over the norm of the gradient; ``None`` where it is not known."""
    moved_cells: float = 0.0
    """The root mean square of the moves of the nodes from the mesh before, in spacings of the uniform mesh."""
    goal: GoalRecord | None = None
    """The functional, where errors are products of those of u and of an adjoint."""

    @property
    def is_resolved(self) -> bool:
        """Whether the mesh is known to resolve the solution."""
        return self.unresolved is not None and self.unresolved <= MAX_UNRESOLVED_SHARE


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The decision from the rounds so far: go on, or end and why."""

    best: int
    """The number of the round with the smallest error."""
    is_done: bool
    """Whether the loop ends."""
    reason: str
    """Why it ends, as a sentence; empty while it goes on."""
    resolved: bool
    """Whether the mesh of the best round resolves the solution: the shape of its layers is known to the mesh."""


def compared(history: Sequence[RoundNumbers], norm: str) -> list[float]:
    """Estimates of all rounds in ``norm`` that can be compared with each other.

    The estimate on the own mesh of a round does not see a layer within one cell. Another mesh may see it: then the
    gradient is larger there. The square of the error of the gradient is the square of its estimate, plus what the
    squared norm of the gradient lacks of the largest one, as for the energy of a Galerkin solution. From
    each norm some squared estimates are taken off first (``DOUBT_FACTORS``), which is all of it for an oscillation from
    node to node. In H1 they are relative to the gradient of the round; in L2 an estimate grows by the same factor.
    For a goal they are roots of the largest error of the functional, in which errors of both signs do not cancel. What
    rounds that resolve the solution do not see is left out: the gradient of the adjoint of a value at a point has no
    limit.
    """
    seen = [_gradient(one) for one in history]
    shares = [DOUBT_FACTORS[one.is_resolved] * (one.unresolved or 0.0) ** 2 for one in history]
    most = max(square * (1.0 - share) for square, share in zip(seen, shares, strict=True))
    found = []
    for one, square in zip(history, seen, strict=True):
        slopes = one.estimate_h1 or 0.0
        if one.estimate == 0.0 or not slopes > 0.0:
            found.append(one.estimate)
            continue
        unseen = 0.0 if one.goal and one.is_resolved else most - square
        whole = math.sqrt(slopes**2 + (unseen if unseen > MIN_UNSEEN * most else 0.0))
        if one.goal:
            found.append(whole / slopes * math.sqrt(one.goal.largest_error))
        else:
            found.append(whole / math.sqrt(square) if norm == "h1" else one.estimate * whole / slopes)
    return found


def _gradient(one: RoundNumbers) -> float:
    """The squared norm of the gradient of the values of a round; 0 where it is not known."""
    return (one.estimate_h1 / one.unresolved) ** 2 if one.estimate_h1 and one.unresolved else 0.0


def fault_of_solver(solve: object) -> str:
    """Why ``solve`` cannot be called with a mesh; empty where it can, or where its signature is not known."""
    if not callable(solve):
        return f"solve = {solve!r:.40} is no function: give one that takes a mesh and returns the solution on it"
    try:
        takes = signature(solve)
    except (TypeError, ValueError):
        return ""
    try:
        takes.bind(None)
    except TypeError as error:
        return f"solve cannot be called as solve(mesh): {error}; give a function of the mesh alone"
    return ""


def judge(history: Sequence[RoundNumbers], rounds: int, norm: str = "l2", tolerance: float | None = None) -> Verdict:
    """The verdict on the rounds so far, of which the first is that of the first mesh; at most ``rounds`` follow it.

    The best round has the smallest of the :func:`compared` estimates, the first of equal ones. The loop ends after two
    rounds in which that did not fall by 15 %, in H1 by 8 %, if the best round resolves the solution, where the mesh
    does not move, and after ``rounds``. The best round resolves the solution where its mesh leaves at most 15 % of the
    gradient unresolved. Two such rounds end it, the last of which is the best one, where the estimated error of the
    functional, plus the change of its corrected value, is at most ``tolerance``.
    """
    reason = "" if tolerance is None else _within(history[-2:], tolerance)
    if reason:
        return Verdict(best=len(history) - 1, is_done=True, reason=reason, resolved=True)
    errors = compared(history, norm)
    best = min(range(len(history)), key=lambda number: errors[number])
    resolved = _is_resolved(history, best)
    reason = _reason(history, errors, rounds, MIN_FALL["h1" if norm == "h1" else "l2"])
    return Verdict(best=best, is_done=reason != "", reason=reason, resolved=resolved)


def _within(last: Sequence[RoundNumbers], tolerance: float) -> str:
    """What is within the ``tolerance`` on the ``last`` two meshes; empty where nothing is, or not known."""
    goals = [one.goal for one in last if one.goal and one.goal.error is not None and one.is_resolved]
    if len(goals) < 2:
        return ""
    error, change = abs(goals[1].error or 0.0), abs(goals[1].corrected - goals[0].corrected)
    if error + change > tolerance:
        return ""
    return (
        f"The estimated error of the functional is {error:.2g}, and its corrected value changed by {change:.2g}: both"
        f" together are within the tolerance of {tolerance:.2g}."
    )


def _reason(history: Sequence[RoundNumbers], errors: Sequence[float], rounds: int, min_fall: float) -> str:
    """Why the loop ends; empty while it goes on."""
    done, stale, least, last = len(history) - 1, 0, errors[0], history[-1]
    if not last.estimate > 0.0:
        if last.unresolved is None:
            return "The error indicator is zero everywhere."
        return "The estimated error is zero: the elements have the solution exactly."
    for error in errors[1:]:
        has_fallen = error <= (1.0 - min_fall) * least
        stale = 0 if has_fallen else stale + 1
        least = error if has_fallen else least
    may_see_more = last.unresolved is not None and not (last.is_resolved or last.moved_cells == 0.0)
    if stale >= PATIENCE and not may_see_more:
        return f"The estimate stands still: it did not fall by {min_fall:.0%} in the last {stale} rounds."
    if done >= rounds:
        said = "the estimate was still falling" if stale == 0 else "the last one brought little"
        return f"It ended after {count_of(rounds)}, the most that was allowed; {said}."
    return ""


def _is_resolved(history: Sequence[RoundNumbers], best: int) -> bool:
    if history[best].estimate == 0.0:  # what is unresolved may be all rounding
        return True
    if history[best].unresolved is not None:
        return history[best].is_resolved
    if len(history) == 1:
        return False
    has_fallen = history[best].estimate <= history[0].estimate / MIN_TOTAL_FALL
    return has_fallen or history[-1].moved_cells <= MAX_REST_CELLS


def count_of(rounds: int) -> str:
    """A number of rounds with its noun."""
    return f"{rounds} round{'' if rounds == 1 else 's'}"


MAX_SHOWN = 12
"""Rounds in the table of a notebook."""


M = TypeVar("M")
"""The class of the meshes: of the solver, or of the client."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AdaptRound(Generic[M]):
    """One solve: its mesh, and what the values say of it. Round 0 is that of the first mesh."""

    number: int
    """0 for the first mesh."""
    mesh: M
    """The mesh that the solver got."""
    values: Array
    """The returned values: at the nodes, shape ``(n_xi, n_eta)``, or the error indicator of every cell, shape
    ``(n_xi - 1, n_eta - 1)``.
    """
    estimate: float
    """The estimated L2 error of the values, in the units of u times a length; of an indicator the root of the sum of
    its squares.
    """
    estimate_h1: float | None = None
    """The estimated error of the gradient; ``None`` for an indicator. A mesh that resolves nothing has a small one."""
    unresolved: float | None = None
    """``estimate_h1`` over the norm of the gradient: the share of the gradient that the mesh does not resolve."""
    moved_cells: float = 0.0
    """The root mean square of the moves of the nodes from the mesh before, in spacings of the uniform mesh."""
    start: str = "given"
    """The candidate that became this mesh, such as ``"lines"``; ``"given"`` for the first mesh."""
    goal: GoalRecord | None = None
    """The functional, where a goal is given. ``estimate_h1`` and ``unresolved`` are then geometric means of those of u
    and z: the first is the root of the sum of their products over the cells.
    """
    adjoint: Array | None = None
    """The adjoint solution at the nodes, where a goal is given."""

    def numbers(self) -> dict[str, Any]:
        """The record without the arrays, as plain Python data, ready for JSON."""
        names = ("estimate", "estimate_h1", "unresolved", "moved_cells")
        found = {name: getattr(self, name) for name in names}
        if self.goal is not None:
            found |= {name: getattr(self.goal, name) for name in ("value", "error", "corrected", "bound")}
        known = {name: value if value is not None and math.isfinite(value) else None for name, value in found.items()}
        return {"number": self.number, "start": self.start, **known}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Adaptation(Generic[M]):
    """The result of a loop: the best mesh, the values on it, and how it was found."""

    rounds: tuple[AdaptRound[M], ...]
    """All rounds, the first mesh included."""
    best: int
    """The number of the round with the smallest error in the norm of the loop.

    Estimates are compared between rounds: what the gradient of one lacks of the gradient of another is error, too.
    """
    resolved: bool
    """Whether the best mesh resolves the solution. Where it is ``False``, estimates are too small, and a solution may
    have layers that no mesh of this size has met.
    """
    reason: str
    """Why the loop ended, as a sentence."""
    failure: Exception | None = None
    """The exception of the solver, or of its values, that ended the loop; the best mesh before it is kept."""

    @property
    def mesh(self) -> M:
        """The mesh of the best round."""
        return self.rounds[self.best].mesh

    @property
    def values(self) -> Array:
        """What the solver returned on that mesh: see :attr:`AdaptRound.values`."""
        return self.rounds[self.best].values

    @property
    def estimate(self) -> float:
        """The estimated L2 error of the best round, or what its error indicator sums up to."""
        return self.rounds[self.best].estimate

    @property
    def goal(self) -> GoalRecord | None:
        """The functional on the mesh of the best round, with its estimated error; ``None`` without a goal."""
        return self.rounds[self.best].goal

    def plot(self, axes: Any = None) -> Any:
        """Draw the mesh of the best round on ``axes`` of matplotlib, or on those of pyplot, and return the axes.

        Cells have the colour of an estimate of their error, or of their error indicator.
        """
        return draw_on(self.mesh, error_of_cells(self.mesh, self.values), axes)

    def _repr_html_(self) -> str:
        """A picture and a table of the rounds, for notebooks."""
        facts = [
            ("best", f"round {self.best}, estimate {self.estimate:.3g}"),
            ("resolved", "yes" if self.resolved else "no: layers may be there that no mesh of this size has met"),
        ]
        if self.goal is not None:
            facts.append(("functional", f"{self.goal.value:.8g}, corrected {self.goal.corrected:.8g}"))
        facts += [(f"round {one.number}", f"estimate {one.estimate:.3g}") for one in self.rounds[:MAX_SHOWN]]
        return html_of(self.reason, facts, picture=picture_of_values(self.mesh, self.values))

    def __repr__(self) -> str:
        how = "resolved" if self.resolved else "not resolved"
        return f"<Adaptation: round {self.best} of {len(self.rounds) - 1}, estimate {self.estimate:.2g}, {how}>"


def verdict_on(done: Sequence[AdaptRound[M]], rounds: int, norm: str, tolerance: float | None = None) -> Verdict:
    """The verdict on the rounds that are done, by the error in ``norm``; at most ``rounds`` follow the first one.

    A functional needs no more rounds than its ``tolerance``.
    """
    numbers = [
        RoundNumbers(
            estimate=one.estimate,
            estimate_h1=one.estimate_h1,
            unresolved=one.unresolved,
            moved_cells=one.moved_cells,
            goal=one.goal,
        )
        for one in done
    ]
    return judge(numbers, rounds, norm, tolerance)


def first_resolved(done: Sequence[AdaptRound[M]]) -> AdaptRound[M] | None:
    """The first round whose mesh resolves the solution: its values tell what equation the solver solves."""
    resolved = (one for one in done if one.unresolved is not None and one.unresolved <= MAX_UNRESOLVED_SHARE)
    return next(resolved, None)


def require_same_kind(done: Sequence[AdaptRound[M]], *, is_indicator: bool) -> None:
    """Raise :class:`BadValues` where a solver returns an error indicator after values, or values after an indicator.

    Their estimates cannot be compared.
    """
    if done and (done[0].estimate_h1 is None) != is_indicator:
        kinds = ("a solution", "an error indicator")
        now, before = kinds[is_indicator], kinds[not is_indicator]
        raise BadValues(f"this solve returned {now}, and those before it {before}: return one kind in all rounds")


def ended(
    done: Sequence[AdaptRound[M]],
    rounds: int,
    norm: str,
    failure: Exception | None = None,
    tolerance: float | None = None,
) -> Adaptation[M]:
    """The result of the rounds that are done; ``failure`` is what ended the loop before its time."""
    verdict = verdict_on(done, rounds, norm, tolerance)
    reason = verdict.reason
    if failure is not None:
        said = f"{type(failure).__name__}: {failure}".strip(": ")
        reason = f"Round {len(done)} failed, and the best mesh before it is kept: {said}"
    return Adaptation(rounds=tuple(done), best=verdict.best, resolved=verdict.resolved, reason=reason, failure=failure)


# The power of an indicator by which the number of cells has to grow: it falls with the cube of the spacing in L2, with
# its square for the gradient.
POWERS: Final = {"l2": 2.0 / 3.0, "h1": 1.0}
# The share of the mean density that is added to it everywhere: cells where the indicator is zero stay bounded.
FLOOR_SHARE: Final = 0.1


def wanted_density(x: Array, y: Array, indicator: Array, norm: Literal["l2", "h1"]) -> Array | None:
    """The wanted density of cells at the nodes (x, y), shape ``(n_xi, n_eta)``, with the mean 1 over the cells.

    It is the density of the cells now, times a power of the ``indicator`` of shape ``(n_xi - 1, n_eta - 1)``. ``None``
    where all indicators are zero.
    """
    area = 0.5 * (
        (x[1:, 1:] - x[:-1, :-1]) * (y[:-1, 1:] - y[1:, :-1]) - (x[:-1, 1:] - x[1:, :-1]) * (y[1:, 1:] - y[:-1, :-1])
    )
    largest = float(indicator.max())
    if not largest > 0.0:
        return None
    density = (indicator / largest) ** POWERS[norm] / area
    density /= float((density * area).sum() / area.sum())
    padded = np.pad(density, 1, mode="edge")
    nodes = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    return np.asarray((nodes + FLOOR_SHARE) / (1.0 + FLOOR_SHARE))
