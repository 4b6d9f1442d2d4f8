"""The status of a solve: one word, with a sentence."""

from enum import StrEnum


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
