"""The progress of a solve: some of the events of the solver, reported to the store."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any

from equimesh import Descent, Event, Grid, Iteration, Schwarz
from equimesh.inputs import finite_or_none
from equimesh_service.errors import AttemptLostError

if TYPE_CHECKING:
    from equimesh.cluster import Progress


# The stages of a solve. A single domain is solved in one; before a Schwarz iteration there is the start.
SINGLE_DOMAIN = "single_domain"
START = "start"
SCHWARZ = "schwarz"
LEAST_ERROR = "least_error"
PARTS = "parts"
# The files are being written.
WRITING = "writing"
# The share of the start of a Schwarz iteration in the whole work.
_START_SHARE = 0.1
# The share of the solve in the whole work; the rest is the writing.
_SOLVE_SHARE = 0.95
# The shares of the solve at which the first, second, ... grid of a target begins; the last number is the end.
_GRID_SHARES = (0.0, 0.1, 0.8, 0.9, 1.0)
# The usual number of Newton steps on a grid.
_USUAL_NEWTON_STEPS = 8.0
# The usual number of sweeps on a grid that is solved in parts.
_USUAL_SWEEPS = 6.0
# The error of a nested start is a few times the error of the grid, and the iteration ends at a fifth of that error.
_START_ERROR_RATIO = 20.0


@dataclass
class Reporter:
    """Receives the events of ``equimesh.solve`` and passes at most one in ``interval`` seconds to ``send``.

    The first is reported after one interval: for a mesh of a few milliseconds only its end is reported. ``send``
    returns False when the attempt is lost; then :class:`AttemptLostError` ends the solve. The fraction never falls.
    """

    schwarz: Schwarz | None
    send: Callable[[Mapping[str, Any]], bool]
    interval: float = 0.05
    _fraction: float = 0.0
    _grids: int = 0
    _first_change: float = math.nan
    _has_reported: bool = False
    _last: float = field(default_factory=lambda: monotonic())

    def begin_grid(self, grid: Grid) -> None:  # noqa: ARG002 - as solve_to calls it
        """Note that a target begins to solve a further grid: each has its share of the whole work."""
        self._grids += 1

    def _solve_fraction(self, done: float) -> float:
        """The part of the whole work that is done, of a share of the solve of the current grid."""
        if not self._grids:
            return _SOLVE_SHARE * done
        number = min(self._grids, len(_GRID_SHARES) - 1)
        begin, end = _GRID_SHARES[number - 1 : number + 1]
        return _SOLVE_SHARE * (begin + (end - begin) * done)

    def __call__(self, event: Event) -> None:
        """Report an event of the solver."""
        if isinstance(event, Iteration):
            self._fraction = max(self._fraction, _SOLVE_SHARE * self._share(event))
            if not self._is_due():  # max_q_eq needs a pass over the mesh
                return
            residual = max(record.residual for record in event.subdomains)
            more = {"max_q_eq": event.max_q_eq, "change": event.change, "min_jacobian": event.min_jacobian}
            self.report(SCHWARZ, event.iteration, residual, more)
            return
        points = [event.grid.n_xi, event.grid.n_eta]
        place: dict[str, Any] = {"level": event.level, "levels": event.levels, "grid": points}
        if isinstance(event, Descent):
            done = (event.level + event.step / event.steps) / event.levels
            self._fraction = max(self._fraction, self._solve_fraction(done))
            numbers: dict[str, Any] = {"error": event.error, "gain": event.gain, "min_jacobian": event.min_jacobian}
            self.report(LEAST_ERROR, event.step, None, {**place, **numbers})
            return
        done = (event.level + min(event.step / _USUAL_NEWTON_STEPS, 1.0)) / event.levels
        self._fraction = max(
            self._fraction, _START_SHARE * done if self.schwarz is not None else self._solve_fraction(done)
        )
        stage = SINGLE_DOMAIN if self.schwarz is None else START
        self.report(stage, event.step, event.residual, place)

    def part(self, event: Progress) -> None:
        """Report a sweep of a mesh in parts; the coarse grids are solved in one part."""
        # A level has four times the points of the one before, and so its share of the work.
        done = 0.25 ** (event.levels - 1 - event.level) * (0.25 + 0.75 * min(event.step / _USUAL_SWEEPS, 1.0))
        self._fraction = max(self._fraction, self._solve_fraction(done))
        grid = [event.grid.n_xi, event.grid.n_eta]
        place = {"level": event.level, "levels": event.levels, "grid": grid, "parts": event.parts}
        self.report(PARTS, event.step, event.residual, place)

    def report(
        self,
        stage: str,
        iteration: int | None,
        residual: float | None,
        more: Mapping[str, Any],
        *,
        always: bool = False,
    ) -> None:
        """Report the progress, unless the last report was a moment ago."""
        if not always and not self._is_due():
            return
        self._last, self._has_reported = monotonic(), True
        numbers = {"residual": residual, **more}
        report = {
            "stage": stage,
            "iteration": iteration,
            "fraction": round(self._fraction, 4),
            **{name: finite_or_none(n) if isinstance(n, float) else n for name, n in numbers.items()},
        }
        if not self.send(report):
            raise AttemptLostError

    def writing(self) -> None:
        """Report that the solve is over and the files are being written."""
        self._fraction = _SOLVE_SHARE
        self.report(WRITING, None, None, {}, always=self._has_reported)

    def _is_due(self) -> bool:
        return monotonic() - self._last >= self.interval

    def _share(self, event: Iteration) -> float:
        if self.schwarz is None:
            return 0.0
        by_count = event.iteration / self.schwarz.max_iterations
        tolerance = self.schwarz.tolerance
        if tolerance is None:
            return by_count
        if math.isnan(self._first_change):
            self._first_change = event.change
        if tolerance == "discretization":
            tolerance = self._first_change / _START_ERROR_RATIO
        # On a logarithmic scale, an error of a steady rate falls by the same distance in each iteration.
        reduction = self._first_change / tolerance
        if not (reduction > 1.0 and event.change > 0.0):
            return by_count
        by_error = math.log(self._first_change / event.change) / math.log(reduction)
        return min(1.0, max(by_count, by_error))
