"""The decisions of a loop that adapts a mesh to a solution, from numbers alone: which round is best, when to stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MIN_FALL = 0.15
"""The share by which the estimate has to fall below the best one before, for a round to count."""
PATIENCE = 2
"""Rounds in a row without that fall after which the loop ends."""
MAX_UNRESOLVED_SHARE = 0.15
"""The largest share of the gradient that a mesh may leave unresolved. A layer within one cell leaves 0.2 to 0.4."""
MIN_RISE = 2.0
"""The least factor over the best estimate that counts as a rise."""
MIN_TOTAL_FALL = 2.0
"""Where that share is not known: the least factor by which the estimate has to fall in all while the mesh moves."""
MAX_REST_CELLS = 1.0
"""Moves of the nodes, in spacings, that count as rest."""


@dataclass(frozen=True, kw_only=True)
class RoundNumbers:
    """Estimates of the solution on the mesh of one round; round 0 is the first mesh."""

    estimate: float
    """The estimated error of the solution on its own mesh, in the norm that ranks. Only its proportions matter."""
    unresolved: float | None = None
    """The estimated error of the gradient over the norm of the gradient; ``None`` where it is not known."""
    moved_cells: float = 0.0
    """The root mean square of the moves of the nodes from the mesh before, in spacings of the uniform mesh."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The decision from the rounds so far: go on, or end and why."""

    best: int
    """The number of the round with the smallest estimate."""
    is_done: bool
    """Whether the loop ends."""
    reason: str
    """Why it ends, as a sentence; empty while it goes on."""
    resolved: bool
    """Whether the mesh of the best round resolves the solution: the shape of its layers is known to the mesh."""


def judge(history: Sequence[RoundNumbers], rounds: int) -> Verdict:
    """The verdict on the rounds so far, of which the first is that of the first mesh; at most ``rounds`` follow it.

    The best round has the smallest estimate, the first of equal ones. The loop ends after two rounds in which the
    estimate did not fall by 15 %, and after ``rounds``. The best round resolves the solution where the mesh leaves at
    most 15 % of the gradient unresolved. The estimate itself cannot tell: it does not see a layer within one cell.
    """
    best = min(range(len(history)), key=lambda number: history[number].estimate)
    reason = _reason(history, rounds)
    return Verdict(best=best, is_done=reason != "", reason=reason, resolved=_is_resolved(history, best))


def _reason(history: Sequence[RoundNumbers], rounds: int) -> str:
    """Why the loop ends; empty while it goes on."""
    done, stale = len(history) - 1, 0
    least = history[0].estimate
    if not history[-1].estimate > 0.0:
        if history[-1].unresolved is None:
            return "The error indicator is zero everywhere."
        return "The estimated error is zero: bilinear elements have the solution exactly."
    for numbers in history[1:]:
        has_fallen = numbers.estimate <= (1.0 - MIN_FALL) * least
        stale = 0 if has_fallen else stale + 1
        least = numbers.estimate if has_fallen else least
    if stale >= PATIENCE and min(one.estimate for one in history[-stale:]) > MIN_RISE * least:
        return f"The estimate rose in the last {stale} rounds: their meshes saw more of the solution than those before."
    if stale >= PATIENCE:
        return f"The estimate stands still: it did not fall by {MIN_FALL:.0%} in the last {stale} rounds."
    if done >= rounds:
        said = "the estimate was still falling" if stale == 0 else "the last one brought little"
        return f"It ended after {count_of(rounds)}, the most that was allowed; {said}."
    return ""


def _is_resolved(history: Sequence[RoundNumbers], best: int) -> bool:
    unresolved = history[best].unresolved
    if unresolved is not None:
        return unresolved <= MAX_UNRESOLVED_SHARE
    if len(history) == 1:
        return history[0].estimate == 0.0
    has_fallen = history[best].estimate <= history[0].estimate / MIN_TOTAL_FALL
    return has_fallen or history[-1].moved_cells <= MAX_REST_CELLS


def count_of(rounds: int) -> str:
    """A number of rounds with its noun."""
    return f"{rounds} round{'' if rounds == 1 else 's'}"
