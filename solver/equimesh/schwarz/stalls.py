"""Signs that an iteration stalls, so that another transmission condition takes over."""

import math

from equimesh.schwarz.conditions import Classical
from equimesh.schwarz.port import MergedSolutions
from equimesh.schwarz.records import estimate_error
from equimesh.schwarz.rescue import Rescue
from equimesh.schwarz.settings import Schwarz

# After this many iterations in which some subdomain took classical data, another condition takes over.
MAX_CLASSICAL_ITERATIONS = 3
# The change of the mesh over the mismatch of the subdomains, at a fixed point that is not the solution.
MAX_FALSE_CHANGE = 1e-3
# A smaller mismatch, in units of the smallest tolerance, is rounding.
MIN_MISMATCH = 100.0
# Iterations over which changes have to fall.
STALL_WINDOW = 8
# The mean factor by which changes have to fall in one iteration. Above it the iteration has stalled.
MAX_RATE = 0.75
# The same for the classical condition, which is slow by nature.
MAX_CLASSICAL_RATE = 1.0
# After this many iterations the deviation of metric lengths tells whether the iteration will be slow.
JUDGED_ITERATIONS = 2
# A larger relative deviation from the mean of a line is then far from the solution. Usually it is 1e-3 or less.
MAX_EARLY_DEVIATION = 1e-2
# An iteration that took more than this many is slow.
MAX_TRUSTED_ITERATIONS = 8


class Stalls:
    """The changes of an iteration with one transmission condition, and the signs of a stall.

    ``changes`` are the largest moves of a coordinate, iteration by iteration, in units of the reference square.
    """

    def __init__(self, settings: Schwarz, rounding: float) -> None:
        self._settings, self._rounding = settings, rounding
        self.changes: list[float] = []
        self._classical_iterations, self._mismatch, self._deviation = 0, 0.0, math.nan

    def note(self, solved: MergedSolutions, change: float, deviation: float) -> None:
        """Note an iteration; ``deviation`` is that of squared metric lengths from the mean of their line."""
        self._deviation = deviation
        self.changes.append(change)
        self._classical_iterations += solved.is_rescued
        self._mismatch = solved.mismatch

    def estimate(self, change: float) -> float:
        """The remaining error after an iteration that moved the mesh by ``change``; NaN where not known."""
        return estimate_error([math.nan, *self.changes, change], self._rounding)

    @property
    def was_slow(self) -> bool:
        """Whether more iterations were needed than a fast iteration takes."""
        return len(self.changes) + 1 > MAX_TRUSTED_ITERATIONS

    @property
    def call_for_newton(self) -> bool:
        """Whether Newton's method takes over the acceleration: where the first iterations came no nearer."""
        judged = len(self.changes) == JUDGED_ITERATIONS and self._settings.may_take_newton
        return judged and not self._deviation <= MAX_EARLY_DEVIATION

    def call_for_another_condition(self, rescue: Rescue) -> bool:
        """Whether the optimized condition takes over; never where the settings do not allow it."""
        if not self._settings.may_fall_back:
            return False
        if rescue.has_failed or self._classical_iterations >= MAX_CLASSICAL_ITERATIONS:
            return True
        return bool(self.changes) and (self._is_at_false_fixed_point() or self._is_slowing_down())

    def _is_at_false_fixed_point(self) -> bool:
        """Whether the mesh hardly moves although the subdomains do not agree."""
        has_mismatch = self._mismatch > MIN_MISMATCH * self._rounding
        return has_mismatch and self.changes[-1] < MAX_FALSE_CHANGE * self._mismatch

    def _is_slowing_down(self) -> bool:
        """Whether the changes fall too slowly, or not at all."""
        if len(self.changes) <= STALL_WINDOW or self.changes[-1] <= self._rounding:
            return False
        rate = MAX_CLASSICAL_RATE if isinstance(self._settings.transmission, Classical) else MAX_RATE
        return self.changes[-1] >= rate**STALL_WINDOW * self.changes[-1 - STALL_WINDOW]
