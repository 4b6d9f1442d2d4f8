"""The progress of a solve: some of the events of the solver, reported to the store."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from equimesh import Descent, Event, Iteration, Schwarz
from equimesh.inputs import finite_or_none
from equimesh_service.errors import AttemptLostError

if TYPE_CHECKING:
    from equimesh_cluster import Progress


# The stages of a solve. A single domain is solved in one; before a Schwarz iteration there is the start.
SINGLE_DOMAIN = "single_domain"
START = "start"
SCHWARZ = "schwarz"
LEAST_ERROR = "least_error"
PARTS = "parts"
# The files are being written.
WRITING = "writing"
# The quality is being measured.
MEASURING = "measuring"
# The share of the solve in the whole work; the rest is the writing and the measuring.
_SOLVE_SHARE = 0.8
# The share of the whole work that is done when most files are written.
_WRITTEN_SHARE = 0.9


@dataclass
class Reporter:
    """Receives the events of ``equimesh.solve`` and passes at most one in ``interval`` seconds to ``send``.

    The first is reported after one interval: for a mesh of a few milliseconds only its end is reported. ``send``
    returns False when the attempt is lost; then :class:`AttemptLostError` ends the solve. The fraction
    never falls; it is None where the solver does not know how much work is ahead.
    """

    schwarz: Schwarz | None
    send: Callable[[Mapping[str, Any]], bool]
    interval: float = 0.05
    _highest: float = 0.0
    _is_known: bool = False
    _phase: str = ""
    _has_reported: bool = False
    _last: float = field(default_factory=lambda: monotonic())

    def __call__(self, event: Event) -> None:
        """Report an event of the solver."""
        if not self.is_due():
            return
        self._note(event.fraction, event.phase)
        if isinstance(event, Iteration):
            residual = max(record.residual for record in event.subdomains)
            more = {"max_q_eq": event.max_q_eq, "change": event.change, "min_jacobian": event.min_jacobian}
            self._report(SCHWARZ, event.iteration, residual, more)
            return
        points = None if event.grid is None else [event.grid.n_xi, event.grid.n_eta]
        place: dict[str, Any] = {"level": event.level, "levels": event.levels, "grid": points}
        if isinstance(event, Descent):
            numbers: dict[str, Any] = {"error": event.error, "gain": event.gain, "min_jacobian": event.min_jacobian}
            self._report(LEAST_ERROR, event.step, None, {**place, **numbers})
            return
        self._report(START if self.schwarz is not None else SINGLE_DOMAIN, event.step, event.residual, place)

    def part(self, event: Progress) -> None:
        """Report a sweep of a mesh in parts; the coarse grids are solved in one part."""
        if not self.is_due():
            return
        self._note(event.fraction, event.phase)
        grid = [event.grid.n_xi, event.grid.n_eta]
        place = {"level": event.level, "levels": event.levels, "grid": grid, "parts": event.parts}
        self._report(PARTS, event.step, event.residual, place)

    def _note(self, fraction: float | None, phase: str) -> None:
        """Note how far a solve is, and what it does."""
        self._phase = phase
        self._is_known = fraction is not None
        self._highest = max(self._highest, _SOLVE_SHARE * (fraction or 0.0))

    def _report(
        self,
        stage: str,
        iteration: int | None,
        residual: float | None,
        more: Mapping[str, Any],
    ) -> None:
        """Report the progress."""
        self._last, self._has_reported = monotonic(), True
        numbers = {"residual": residual, **more}
        report = {
            "stage": stage,
            "iteration": iteration,
            "fraction": round(self._highest, 4) if self._is_known else None,
            "phase": self._phase,
            **{name: finite_or_none(n) if isinstance(n, float) else n for name, n in numbers.items()},
        }
        if not self.send(report):
            raise AttemptLostError

    def writing(self) -> None:
        """Report that the solve is over and the files are being written."""
        self._stage(WRITING, "writing the files", _SOLVE_SHARE)

    def measuring(self) -> None:
        """Report that the quality of the mesh is being measured."""
        self._stage(MEASURING, "measuring the quality", _WRITTEN_SHARE)

    def _stage(self, stage: str, phase: str, share: float) -> None:
        """Report a stage after the solve."""
        self._note(share / _SOLVE_SHARE, phase)
        if self._has_reported or self.is_due():
            self._report(stage, None, None, {})

    def is_due(self) -> bool:
        """Whether enough time has passed since the last report; the solver makes no record before."""
        return monotonic() - self._last >= self.interval
