"""Settings of the Schwarz iteration: the subdomains, their exchange of data, and the acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from numbers import Integral
from typing import Literal, TypeAlias, TypeGuard, get_args

from equimesh.errors import DecompositionError, InputError
from equimesh.inputs import choice, keep_floats, require_flag
from equimesh.meshes.mesh import Grid
from equimesh.numerics.types import IntArray
from equimesh.schwarz.conditions import Optimized, TransmissionCondition
from equimesh.schwarz.decomposition import MIN_OVERLAP, Cuts, Decomposition, Ordering
from equimesh_schema.document import is_number, is_whole

# Line corrections after every iteration of the optimized condition, unless the settings differ.
DEFAULT_LINE_CORRECTIONS = 3
# More line corrections than this would turn the iteration into a single-domain solve.
MAX_LINE_CORRECTIONS = 10

Auto: TypeAlias = Literal["auto"]
Discretization: TypeAlias = Literal["discretization"]
Division: TypeAlias = int | Cuts
"""The number of subdomains in one direction, or the grid lines at which they meet."""


Groups: TypeAlias = Sequence[Sequence[str | int]]
MIN_CELLS = 2
"""Cells of a subdomain in each direction, at least, for least error on a grid."""
MAX_LAYERS = 64
"""Layers of cells of the overlap of blocks, at most: with more, a subdomain does most of the work of the whole mesh."""
MAX_STEPS = 1000
"""Steps of a subdomain in one exchange, and exchanges, at most."""
OF_DESCENT = ("local_steps", "max_exchanges")
"""The settings that only least error has."""
OF_EQUATIONS = (
    "transmission",
    "ordering",
    "line_correction",
    "acceleration",
    "local_solver",
    "fallback",
    "tolerance",
    "max_iterations",
    "compare_single_domain",
)
"""The settings that only equidistribution has."""


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
    """Settings of the Schwarz iteration between subdomains: rectangles of a grid, or the blocks of a domain.

    **Equidistribution on a grid**: ``subdomains`` along xi and eta, ``overlap`` in points, as in
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

    **Least error**: coarse meshes are solved whole. On the finest mesh every subdomain takes ``local_steps`` of descent
    with the others held; then all moves are merged, and subdomains exchange them. ``subdomains`` are the rectangles of
    a grid, as above. On a domain in blocks a subdomain is a block, or a group of blocks: ``groups`` has names or
    numbers of blocks, each block once. A subdomain also has ``overlap`` layers of cells of its neighbours.
    ``max_exchanges`` is by default as many as take the steps of a solve of the whole mesh.

    A setting that the method or the domain does not have is refused where it differs from its default. Raises
    :class:`~equimesh.errors.InputError` with a field such as ``schwarz.overlap``.
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
    local_steps: int = 8
    max_exchanges: int | None = None
    groups: Groups | None = None

    def __post_init__(self) -> None:
        self._check_numbers()
        if not isinstance(self.transmission, TransmissionCondition):
            raise InputError(
                f"transmission = {str(self.transmission)[:40]!r}: give one of"
                f" {', '.join(f'{kind.__name__}()' for kind in get_args(TransmissionCondition))}",
                field="schwarz.transmission",
            )
        for name in ("fallback", "compare_single_domain"):
            require_flag(getattr(self, name), name, "schwarz.")
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
        self._check_exchanges()
        keep_floats(self, "tolerance")
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

    def _check_exchanges(self) -> None:
        require_count(self.local_steps, "local_steps", MAX_STEPS)
        if self.max_exchanges is not None:
            require_count(self.max_exchanges, "max_exchanges", MAX_STEPS)
        if self.groups is not None:
            object.__setattr__(self, "groups", _tuples(self.groups))

    def require_equations(self) -> None:
        """Raise :class:`~equimesh.errors.InputError` for settings that only least error or blocks have."""
        self._require_default(
            OF_DESCENT, "settings of least error, and this monitor is equidistributed: leave it out, or take LeastError"
        )
        self._require_default(("groups",), "settings of blocks, and this domain has a grid: leave it out")

    def require_descent(self) -> None:
        """Raise :class:`~equimesh.errors.InputError` for what least error on a grid does not have."""
        self._require_default(
            OF_EQUATIONS,
            "settings of equidistribution, and least error has no equations that subdomains could exchange: leave it"
            " out, and give subdomains, overlap, local_steps or max_exchanges",
        )
        self._require_default(("groups",), "settings of blocks, and this domain has a grid: leave it out")
        require_count(self.overlap, "overlap", MAX_LAYERS)

    def require_blocks(self) -> None:
        """Raise :class:`~equimesh.errors.InputError` for settings that only a grid has, and for a large overlap."""
        self._require_default(
            ("subdomains", *OF_EQUATIONS),
            "settings of the rectangles of a grid, and this domain has blocks, which are the subdomains: leave it out,"
            " and group blocks by groups",
        )
        require_count(self.overlap, "overlap", MAX_LAYERS)

    def _require_default(self, names: tuple[str, ...], why: str) -> None:
        usual = Schwarz()
        for name in names:
            if getattr(self, name) != getattr(usual, name):
                raise InputError(f"{name} is one of the {why}", field=f"schwarz.{name}")

    def exchanges(self, steps: int) -> int:
        """The largest number of exchanges, where the descent of the whole mesh would take this number of ``steps``."""
        return self.max_exchanges or max(1, math.ceil(steps / self.local_steps))

    def _check_newton(self) -> None:
        """Refuse Newton's method for iterations whose derivative is not implemented."""
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

    def owner_of_cells(self, grid: Grid) -> IntArray:
        """The number of the subdomain that owns each cell, shape ``(cells,)``, for least error on a grid.

        Raises :class:`~equimesh.errors.InputError` for subdomains of less than ``MIN_CELLS`` in a direction, and for
        grid lines that subdomains cannot meet at.
        """
        for direction, points, count in zip(("xi", "eta"), grid.shape, self.counts, strict=True):
            most = (points - 1) // MIN_CELLS
            if not 1 <= count <= most:
                raise InputError(
                    f"{count} subdomains in {direction} do not fit {points - 1} cells, of which each needs {MIN_CELLS}:"
                    f" give 1 to {most}, or take more grid points",
                    field="schwarz.subdomains",
                )
        try:
            return self.rectangles(grid).owner_of_cells().ravel()
        except DecompositionError as error:
            raise InputError(str(error), field=f"schwarz.{error.field}") from None

    def rectangles(self, grid: Grid) -> Decomposition:
        """The rectangles of a grid for least error, without the layers of cells of their neighbours."""
        return replace(self, overlap=MIN_OVERLAP).decompose(grid)

    @property
    def counts(self) -> tuple[int, int]:
        """The numbers of subdomains along xi and along eta."""
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


def require_count(value: object, name: str, most: int) -> None:
    """Raise :class:`~equimesh.errors.InputError` for what is no whole number from 1 to ``most``."""
    if not (is_whole(value) and 1 <= value <= most):
        message = f"{name} = {str(value)[:20]}: a whole number from 1 to {most}"
        raise InputError(message, field=f"schwarz.{name}")


def _tuples(groups: object) -> tuple[tuple[str | int, ...], ...]:
    """The groups as tuples."""
    if not (
        isinstance(groups, list | tuple) and groups and all(isinstance(one, list | tuple) and one for one in groups)
    ):
        raise InputError(
            "groups: give a list of groups, each a list of names or numbers of blocks: [['inlet', 'top'], ['outlet']]",
            field="schwarz.groups",
        )
    return tuple(tuple(group) for group in groups)


def _is_positive(number: object) -> bool:
    return is_number(number) and math.isfinite(number) and number > 0


def _is_division(part: object) -> bool:
    """Whether the value is a number of subdomains, or a list of grid lines."""
    return _is_whole(part) or (isinstance(part, tuple | list) and all(map(_is_whole, part)))


def _is_whole(number: object) -> TypeGuard[int]:
    return isinstance(number, Integral) and not isinstance(number, bool)
