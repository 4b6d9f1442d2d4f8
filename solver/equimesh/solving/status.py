"""How a solve ended: one status, with a sentence."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How a solve ended. ``sentence`` says what happened."""

    CONVERGED = "converged"
    RELAXED = "relaxed"
    COMPLETED = "completed"
    NOT_CONVERGED = "not_converged"
    NEWTON_FAILED = "newton_failed"
    FOLDED = "folded"

    @property
    def succeeded(self) -> bool:
        """Whether the mesh is what was asked for, or as near to it as was allowed."""
        return self in (Status.CONVERGED, Status.RELAXED, Status.COMPLETED)

    @property
    def sentence(self) -> str:
        """What happened."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.CONVERGED: "The mesh satisfies the equidistribution equations to the asked tolerance.",
    Status.RELAXED: "The mesh is valid, but satisfies weaker equations than the asked ones, for which none was found.",
    Status.COMPLETED: "The asked number of Schwarz iterations was run, without a tolerance to meet.",
    Status.NOT_CONVERGED: "The Schwarz iteration did not reach its tolerance within the allowed iterations.",
    Status.NEWTON_FAILED: "No valid mesh was found that satisfies the equations.",
    Status.FOLDED: "The mesh has an inverted cell.",
}
