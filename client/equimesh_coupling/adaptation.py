"""The records of a loop that adapts a mesh to the solution of a solver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array
from equimesh_coupling.rounds import RoundNumbers, Verdict, judge

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
    """The estimated error of the gradient; ``None`` for an indicator. It must not rank meshes: see ``unresolved``."""
    unresolved: float | None = None
    """``estimate_h1`` over the norm of the gradient: the share of the gradient that the mesh does not resolve.

    It ranks meshes for the norm ``"h1"``. A mesh that resolves nothing has a small ``estimate_h1``, but a large share.
    """
    moved_cells: float = 0.0
    """The root mean square of the moves of the nodes from the mesh before, in spacings of the uniform mesh."""
    start: str = "given"
    """The candidate that became this mesh, such as ``"lines"``; ``"given"`` for the first mesh."""

    def rank(self, norm: str) -> float:
        """The number by which rounds are compared for an error in ``norm``, the smallest is best; 0 where u is exact.

        An error indicator says nothing of norms.
        """
        if norm == "l2" or self.unresolved is None or self.estimate == 0.0:
            return self.estimate
        return self.unresolved

    def numbers(self) -> dict[str, Any]:
        """The record without the arrays, as plain Python data, ready for JSON."""
        names = ("estimate", "estimate_h1", "unresolved", "moved_cells")
        found = {name: getattr(self, name) for name in names}
        known = {name: value if value is not None and math.isfinite(value) else None for name, value in found.items()}
        return {"number": self.number, "start": self.start, **known}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Adaptation(Generic[M]):
    """The result of a loop: the best mesh, the values on it, and how it was found."""

    rounds: tuple[AdaptRound[M], ...]
    """All rounds, the first mesh included."""
    best: int
    """The number of the round with the smallest estimate; for the norm ``"h1"`` that with the smallest share
    :attr:`AdaptRound.unresolved`.
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

    def __repr__(self) -> str:
        how = "resolved" if self.resolved else "not resolved"
        return f"<Adaptation: round {self.best} of {len(self.rounds) - 1}, estimate {self.estimate:.2g}, {how}>"


def verdict_on(done: Sequence[AdaptRound[M]], rounds: int, norm: str) -> Verdict:
    """The verdict on the rounds that are done, by the error in ``norm``; at most ``rounds`` follow the first one."""
    return judge(
        [RoundNumbers(estimate=one.rank(norm), unresolved=one.unresolved, moved_cells=one.moved_cells) for one in done],
        rounds,
    )


def require_same_kind(done: Sequence[AdaptRound[M]], *, is_indicator: bool) -> None:
    """Raise :class:`BadValues` where a solver returns an error indicator after values, or values after an indicator.

    Their estimates cannot be compared.
    """
    if done and (done[0].estimate_h1 is None) != is_indicator:
        kinds = ("a solution", "an error indicator")
        now, before = kinds[is_indicator], kinds[not is_indicator]
        raise BadValues(f"this solve returned {now}, and those before it {before}: return one kind in all rounds")


def ended(done: Sequence[AdaptRound[M]], rounds: int, norm: str, failure: Exception | None = None) -> Adaptation[M]:
    """The result of the rounds that are done; ``failure`` is what ended the loop before its time."""
    verdict = verdict_on(done, rounds, norm)
    reason = verdict.reason
    if failure is not None:
        said = f"{type(failure).__name__}: {failure}".strip(": ")
        reason = f"Round {len(done)} failed, and the best mesh before it is kept: {said}"
    return Adaptation(rounds=tuple(done), best=verdict.best, resolved=verdict.resolved, reason=reason, failure=failure)
