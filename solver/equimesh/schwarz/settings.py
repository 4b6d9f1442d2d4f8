"""Settings of the Schwarz iteration: the subdomains, their exchange of data, and the acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from numbers import Integral
from typing import Literal, TypeAlias, TypeGuard

from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.meshes.mesh import Grid
from equimesh.schwarz.conditions import Optimized, TransmissionCondition
from equimesh.schwarz.decomposition import Cuts, Decomposition, Ordering

# Line corrections after every iteration of the optimized condition, unless the settings differ.
DEFAULT_LINE_CORRECTIONS = 3
# More line corrections than this would turn the iteration into a single-domain solve.
MAX_LINE_CORRECTIONS = 10

Auto: TypeAlias = Literal["auto"]
Discretization: TypeAlias = Literal["discretization"]
Division: TypeAlias = int | Cuts
"""How many subdomains there are in one direction, or the grid lines at which they meet."""


class Acceleration(StrEnum):
    """The acceleration of the iteration.

    ``NONE``: the last iteration is taken unchanged. ``ANDERSON``: the combination of the last ones whose changes nearly
    cancel, where it does not fold. ``NEWTON``: Newton's method for the fixed point of the parallel iteration (RASPEN):
    few iterations and many sparse solves; subdomains are solved by Newton's method, too.
    """

    NONE = "none"
    ANDERSON = "anderson"
    NEWTON = "newton"


class LocalSolver(StrEnum):
    """The solver of a subdomain.

    ``SWEEPS``: line corrections, as accurate as an iteration needs; Newton's method where they fail, and for conditions
    without sweeps. ``NEWTON``: Newton's method with sparse factorisations, to rounding: the reference.
    """

    SWEEPS = "sweeps"
    NEWTON = "newton"


@dataclass(frozen=True, kw_only=True)
class Schwarz:
    """Settings of the Schwarz iteration.

    ``subdomains`` along xi and eta, ``overlap`` in points, as in
    :class:`~equimesh.schwarz.decomposition.Decomposition`. In place of a number, a direction can have the grid lines
    at which its subdomains meet: ``((24, 40), 1)`` are three strips.

    ``line_correction`` is how many times all grid lines are corrected as a whole after every iteration; "auto" is 3
    for the optimized condition and none for the paper's. ``acceleration="auto"`` is Anderson's for the optimized
    condition and wherever lines are corrected, or else none; where the first iterations come no nearer, Newton's
    method takes over.
    ``fallback`` lets the optimized condition take over where another stalls, and a single domain where all do.

    The iteration ends when the estimated error of the merged mesh (max norm of node positions, in units of the
    reference square) is at most ``tolerance``; ``tolerance="discretization"`` is a fifth of the error of the grid;
    with ``tolerance=None`` it runs exactly ``max_iterations``. ``compare_single_domain`` solves the
    single-domain problem first and records the error against it.
    """

    subdomains: tuple[Division, Division] = (2, 1)
    overlap: int = 4
    transmission: TransmissionCondition = field(default_factory=Optimized)
    ordering: Ordering = Ordering.PARALLEL
    line_correction: int | Auto = "auto"
    acceleration: Acceleration | Auto = "auto"
    local_solver: LocalSolver = LocalSolver.SWEEPS
    fallback: bool = True
    tolerance: float | Discretization | None = 1e-10
    max_iterations: int = 100
    compare_single_domain: bool = False

    def __post_init__(self) -> None:
        self._check_numbers()
        if not isinstance(self.transmission, TransmissionCondition):
            raise InputError(
                f"transmission = {str(self.transmission)[:40]!r}: give Optimized(), Classical(), LinearRobin() or"
                " NonlinearRobin()",
                field="schwarz.transmission",
            )
        object.__setattr__(self, "ordering", choice(Ordering, self.ordering, "schwarz.ordering"))
        object.__setattr__(self, "local_solver", choice(LocalSolver, self.local_solver, "schwarz.local_solver"))
        if self.acceleration != "auto":
            object.__setattr__(self, "acceleration", choice(Acceleration, self.acceleration, "schwarz.acceleration"))
        corrections = self.line_correction
        if corrections != "auto" and not (_is_whole(corrections) and 0 <= corrections <= MAX_LINE_CORRECTIONS):
            raise InputError(
                f'line_correction = {corrections!r}: a whole number from 0 to {MAX_LINE_CORRECTIONS}, or "auto"',
                field="schwarz.line_correction",
            )
        self._check_newton()
        if not (self.tolerance is None or self.tolerance == "discretization" or _is_positive(self.tolerance)):
            raise InputError(
                f'tolerance = {self.tolerance!r}: must be positive, or "discretization", or null for a fixed number of'
                " iterations",
                field="schwarz.tolerance",
            )
        if not (_is_whole(self.max_iterations) and self.max_iterations >= 1):
            raise InputError(
                f"max_iterations = {self.max_iterations}: a whole number, at least 1", field="schwarz.max_iterations"
            )

    def _check_newton(self) -> None:
        """Refuse Newton's method for iterations of which it does not know the derivative."""
        if self.acceleration != Acceleration.NEWTON:
            return
        if self.ordering is not Ordering.PARALLEL:
            raise InputError(
                f'ordering = "{self.ordering}" with acceleration = "newton": Newton\'s method needs "parallel"',
                field="schwarz.ordering",
            )
        if self.line_corrections:
            raise InputError(
                f'line_correction = {self.line_correction} with acceleration = "newton": must be 0, or "auto"',
                field="schwarz.line_correction",
            )

    def _check_numbers(self) -> None:
        counts = self.subdomains
        if not (isinstance(counts, tuple | list) and len(counts) == 2 and all(map(_is_division, counts))):
            raise InputError(
                f"subdomains = {counts!r}: give two whole numbers, along xi and eta, (4, 1) or (2, 2) for instance; or"
                " in place of a number the grid lines at which subdomains meet, ((24, 40), 1) for instance",
                field="schwarz.subdomains",
            )
        divided = tuple(tuple(part) if isinstance(part, tuple | list) else part for part in counts)
        object.__setattr__(self, "subdomains", divided)
        if not _is_whole(self.overlap):
            raise InputError(f"overlap = {self.overlap!r}: a whole number of points", field="schwarz.overlap")

    @property
    def ghosts(self) -> int:
        """Grid lines beyond every interface that a subdomain reads of the merged mesh."""
        return max(self.transmission.ghosts, int(self.line_corrections > 0))

    def decompose(self, grid: Grid) -> Decomposition:
        """The subdomains on a grid; raises :class:`~equimesh.errors.DecompositionError` where they do not fit."""
        cuts = tuple(part if isinstance(part, tuple) else None for part in self.subdomains)
        return Decomposition(grid=grid, subdomains=self.counts, overlap=self.overlap, cuts=(cuts[0], cuts[1]))

    @property
    def counts(self) -> tuple[int, int]:
        """How many subdomains there are along xi and along eta."""
        xi, eta = (len(part) + 1 if isinstance(part, tuple) else part for part in self.subdomains)
        return xi, eta

    @property
    def is_optimized(self) -> bool:
        """Whether interfaces yield; the paper's conditions exchange functionals instead."""
        return isinstance(self.transmission, Optimized)

    @property
    def line_corrections(self) -> int:
        """Line corrections after every iteration, "auto" resolved."""
        if self.line_correction == "auto":
            return DEFAULT_LINE_CORRECTIONS if self.is_optimized and self.acceleration != Acceleration.NEWTON else 0
        return self.line_correction

    @property
    def accelerated_by(self) -> Acceleration:
        """The acceleration, "auto" resolved."""
        if self.acceleration == "auto":
            return Acceleration.ANDERSON if self.is_optimized or self.line_corrections else Acceleration.NONE
        return Acceleration(self.acceleration)

    @property
    def solved_by(self) -> LocalSolver:
        """The solver of the subdomains: acceleration by Newton's method needs solutions to rounding."""
        return LocalSolver.NEWTON if self.accelerated_by is Acceleration.NEWTON else self.local_solver

    @property
    def may_fall_back(self) -> bool:
        """Whether the optimized condition may take over where this one stalls."""
        return self.fallback and self.transmission != Optimized()

    @property
    def may_take_newton(self) -> bool:
        """Whether Newton's method may accelerate a slow iteration: where "auto" leaves the choice to the iteration."""
        chosen = self.acceleration == "auto" and self.line_correction == "auto"
        return chosen and self.is_optimized and self.ordering is Ordering.PARALLEL

    def after_slow_iterations(self) -> Schwarz:
        """The settings that accelerate a slow iteration."""
        return replace(self, acceleration=Acceleration.NEWTON)

    def after_fallback(self) -> Schwarz:
        """The settings that take over where these stall."""
        return replace(
            self,
            transmission=Optimized(),
            line_correction="auto",
            acceleration="auto",
            local_solver=LocalSolver.SWEEPS,
        )


def _is_positive(number: object) -> bool:
    return isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number) and number > 0


def _is_division(part: object) -> bool:
    """Whether the value is a number of subdomains, or a list of grid lines."""
    return _is_whole(part) or (isinstance(part, tuple | list) and all(map(_is_whole, part)))


def _is_whole(number: object) -> TypeGuard[int]:
    return isinstance(number, Integral) and not isinstance(number, bool)
