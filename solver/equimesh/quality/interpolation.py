"""The errors of interpolating u on a mesh, compared with the uniform mesh of its size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from equimesh.domains.domain import Rectangle
from equimesh.errors import InputError
from equimesh.fields.expression import Expression, Field
from equimesh.fields.samples import GridSamples
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import (
    AnyMesh,
    CellPoints,
    Cells,
    ChosenCells,
    MeshCells,
    UniformCells,
    cells_of,
)
from equimesh.quality.resolution import Pieces, resolved_integrals, scattered_between
from equimesh.quality.tally import ErrorRule, ErrorTally

MIN_SAMPLED_CELLS = 3_200
"""Cells on which errors are sampled, or up to three times as many; on smaller meshes all cells."""
SAMPLING = ((89, 34), (34, 13), (13, 5), (5, 2))  # one cell of this many; the shift from row to row
ROUNDING_SHARE = 1e-13
"""Share of u that counts as rounding in its values."""
CENTRE = CellPoints(np.array([0.5]), np.array([0.5]), np.array([1.0]))
"""The centre of a cell."""


class LargestError(NamedTuple):
    """The largest error of interpolation at a point of quadrature, and the centre of its cell."""

    value: float
    x: float
    y: float


@dataclass(frozen=True, kw_only=True)
class InterpolationErrors:
    """Error of the isoparametric Q1 interpolant of u, on the mesh and on the uniform one of its size.

    A mesh of blocks is compared with its initial mesh, whose errors are ``l2_uniform`` and ``h1_uniform`` then.
    :func:`~equimesh.quality.degrees.degree_errors` returns those of other interpolants, also on triangles.

    ``l2`` is the norm of ``u - u_h``, ``h1`` that of ``grad u - grad u_h``; both over the whole domain, in the units of
    u and of its gradient times a length. Infinite on a folded mesh. ``rounding`` is the part of the two that is due to
    rounding. ``size`` is the largest size of u at a corner, ``variation`` the largest value of u at the points of
    quadrature minus the smallest one, ``largest`` the largest error there on this mesh; NaN and ``None`` on a folded
    mesh. ``resolved`` says of each norm whether two rules of quadrature agree on both meshes, to 5 % in L2 and to 1 %
    in H1.
    """

    l2: float
    l2_uniform: float
    h1: float
    h1_uniform: float
    rounding: tuple[float, float] = (0.0, 0.0)
    resolved: tuple[bool, bool] = (True, True)
    size: float = math.nan
    variation: float = math.nan
    largest: LargestError | None = None
    degree: int = 1
    """The degree of the interpolant: of degree p it has its nodes at the Gauss-Lobatto points of each cell."""

    @property
    def gain_l2(self) -> float:
        """``l2_uniform / l2``: how many times smaller the error is than on the uniform mesh; below 1 it is larger.

        NaN where the norm is not resolved.
        """
        return self.estimated_gain("l2") if self.resolved[0] else math.nan

    @property
    def gain_h1(self) -> float:
        """``h1_uniform / h1``, NaN where the norm is not resolved."""
        return self.estimated_gain("h1") if self.resolved[1] else math.nan

    @property
    def is_exact(self) -> bool:
        """Whether the L2 errors on both meshes are rounding."""
        return max(self.l2, self.l2_uniform) <= self.rounding[0]

    def against(self, plain: InterpolationErrors | Norms) -> InterpolationErrors:
        """The errors of a mesh that was measured alone, next to the ``plain`` ones of the uniform or initial mesh."""
        resolved = (self.resolved[0] and plain.resolved[0], self.resolved[1] and plain.resolved[1])
        return replace(self, l2_uniform=plain.l2, h1_uniform=plain.h1, resolved=resolved)

    def estimated_gain(self, norm: str) -> float:
        """The gain in ``norm``, ``"l2"`` or ``"h1"``, by the best estimate of the errors: also where not resolved."""
        if norm == "l2":
            return gain_of(self.l2_uniform, self.l2, self.rounding[0])
        return gain_of(self.h1_uniform, self.h1, self.rounding[1])


def require_same_cells(cells: Cells, uniform: Cells | None) -> None:
    """Raise :class:`~equimesh.errors.InputError` where two meshes are compared that differ in their cells."""
    if uniform is not None and uniform.count != cells.count:
        raise InputError(
            f"this mesh has {cells.count} cells, and the one that it is compared with {uniform.count}: compare it with "
            "the mesh that it began with",
            field="uniform",
        )


_kept: WeakKeyDictionary[Field, dict[Any, list[Any]]] = WeakKeyDictionary()


def kept_of_uniform(u: Field, cells: Cells, what: object) -> list[Any]:
    """An empty list, and in later calls what the caller put into it: what is known of u on a uniform mesh.

    Meshes of one size are compared with the same uniform one. It is kept as long as u is, of functions that nobody can
    change, on rectangles.
    """
    if not (isinstance(u, Expression | GridSamples) and isinstance(cells, UniformCells) and cells.rows.are_all):
        return []
    if not isinstance(cells.domain, Rectangle):
        return []
    # Formulas with the parameters 0 and -0 are equal, but can have other values.
    own = u.routine(1) if isinstance(u, Expression) else None
    return _kept.setdefault(u, {}).setdefault((cells.domain, cells.grid, what, own), [])


class Norms(NamedTuple):
    """L2 norm and H1 seminorm of an error, the largest value of u at a corner, and whether the two are resolved."""

    l2: float
    h1: float
    size: float
    resolved: tuple[bool, bool] = (True, True)
    variation: float = math.nan
    largest: LargestError | None = None


def compared(cells: Cells, here: Norms, there: Norms) -> InterpolationErrors:
    """The errors ``here``, on ``cells``, next to those ``there``, on the uniform mesh."""
    return InterpolationErrors(
        l2=here.l2,
        l2_uniform=there.l2,
        h1=here.h1,
        h1_uniform=there.h1,
        rounding=noise(cells, here.size),
        resolved=(here.resolved[0] and there.resolved[0], here.resolved[1] and there.resolved[1]),
        size=here.size,
        variation=here.variation,
        largest=here.largest,
    )


NO_ERROR = LargestError(0.0, math.nan, math.nan)
"""The largest error in no cells."""
FOLDED = Norms(math.inf, math.inf, math.nan)
"""The norms on a folded mesh."""
UNKNOWN = Norms(math.nan, math.nan, math.nan)
"""The norms on a mesh that is not given."""


def norms(
    cells: Cells,
    u: Field,
    rule: ErrorRule,
    numbers: IntArray | None,
    *,
    nodal: Array | None = None,
    threads: int = 1,
) -> Norms:
    """The norms of u minus its Q1 interpolant: by ``rule``, or by a finer one where a second rule does not agree."""
    if not cells.all_valid:
        return FOLDED
    tally = ErrorTally.of(cells, u, rule, numbers, nodal)
    tally.add_all(threads)
    return norms_of(tally)


def norms_of(tally: ErrorTally) -> Norms:
    """The norms from the errors at the points of a rule."""
    cells, chosen = tally.cells, tally.chosen
    if isinstance(cells, UniformCells):  # which others are compared with: of these alone the rest is told
        (size,) = cells.rows.agreed(tally.size)
        extremes = Extremes(size, math.nan, NO_ERROR)
    else:
        extremes = Extremes.of(cells.rows, tally.size, tally.range, _peak(tally))
    allowed = noise(cells, extremes.size)
    squares = (allowed[0] * allowed[0], allowed[1] * allowed[1])

    def pieces(some: IntArray) -> Pieces:
        corners, there = tally.pieces(some)
        return Pieces(corners, there, there)

    found = resolved_integrals(pieces, chosen, tally.sums[:2], tally.u, squares)
    l2, h1 = (math.sqrt(square * cells.count / found.cells) for square in found.squares)
    return Norms(l2, h1, extremes.size, found.resolved, extremes.variation, extremes.peak)


def _peak(tally: ErrorTally) -> LargestError:
    """The largest error at a point of the own cells."""
    if not tally.largest.size:
        return NO_ERROR
    worst = int(tally.largest.argmax())
    (x0,), (x1,), (x2,), (x3,), *y = tally.cells.corners(tally.chosen.numbers[worst : worst + 1]).tolist()
    return LargestError(float(tally.largest[worst]), 0.25 * (x0 + x1 + x2 + x3), 0.25 * sum(one for (one,) in y))


class Extremes(NamedTuple):
    """Extremes of u on the whole mesh: its largest size at a corner, its variation, and the largest error."""

    size: float
    variation: float
    peak: LargestError

    @classmethod
    def of(cls, rows: Rows, size: float, ends: tuple[float, float], peak: LargestError) -> Extremes:
        """From the largest ``size`` at a corner of the own cells, the ``ends`` of the values there and at other points,
        and the largest error in the own cells."""
        if rows.are_all:
            return cls(size, ends[1] - ends[0], peak)
        found = rows.joined(np.array([[size, *ends, *peak]]))
        low, high = np.fmin.reduce(found[:, 1]), np.fmax.reduce(found[:, 2])
        worst = found[found[:, 3].argmax(), 3:]
        return cls(float(found[:, 0].max()), float(high - low), LargestError(*map(float, worst)))


def noise(cells: Cells, size: float) -> tuple[float, float]:
    """The parts of the two norms that rounding causes, where ``size`` is the largest value of u."""
    of_values = ROUNDING_SHARE * size * math.sqrt(abs(cells.total_area)) if math.isfinite(size) else 0.0
    finest = cells.across / math.sqrt(abs(cells.total_area) or 1.0)
    return of_values, 10.0 * of_values * finest


def sample(rows: Rows) -> IntArray | None:
    """Numbers of the own cells in the sample: a lattice with the same share of every row and column.

    Cells of blocks, which count as one column, are :func:`~equimesh.quality.resolution.scattered`.
    """
    cells, columns = rows.cells
    for one_of, shift in SAMPLING:
        if cells * columns >= one_of * MIN_SAMPLED_CELLS:
            if columns == 1:
                return scattered_between(0, cells, one_of)
            lines = np.arange(rows.first, rows.last)[:, None]
            places = (-shift * lines) % one_of + np.arange(0, columns, one_of)
            return np.asarray((places + lines * columns)[places < columns], dtype=np.int64)
    return None


def gain_of(uniform: float, adapted: float, rounding: float) -> float:
    """The error on the uniform mesh over that on the adapted one; 1 where both are at most ``rounding``.

    NaN where one of them is not known.
    """
    if math.isnan(uniform) or math.isnan(adapted):
        return math.nan
    if max(uniform, adapted) <= rounding:
        return 1.0
    return uniform / adapted if adapted > 0.0 else math.inf


# Probes of u between the nodes of a mesh, at more points than quadrature has.

PROBES = 65_536
"""Probes of a mesh, about."""
MAX_PROBES_PER_CELL = 64
"""Probes of a cell, at most."""
SHARES = (0.7548776662466927, 0.5698402909980532)
"""Steps of the two coordinates of a sequence that fills the square evenly: powers of the plastic number."""


def probe_errors(mesh: AnyMesh, u: Field) -> tuple[LargestError, float]:
    """The largest difference of u and its bilinear interpolant at the probes, and the range of u.

    The range is the largest value at the probes and the nodes minus the smallest one. The place of the largest
    difference is the place of the probe. Every cell has the same number of probes, at different places. Values that are
    not finite are left out.
    """
    cells = cells_of(mesh)
    with np.errstate(all="ignore"):
        found = cells.rows.joined(np.array([*_probed(cells, u)]))
        variation = float(np.fmax.reduce(found[:, 1]) - np.fmin.reduce(found[:, 0]))
    return LargestError(*map(float, found[found[:, 2].argmax(), 2:])), variation


def _probed(cells: MeshCells, u: Field) -> Iterator[tuple[float, ...]]:
    """The smallest and largest u, the largest error and its place: at the nodes, then in pieces of the cells."""
    nodal = u.evaluate(*cells.nodes)[0]
    yield float(np.nanmin(nodal)), float(np.nanmax(nodal)), 0.0, np.nan, np.nan
    for _, numbers in cells.blocks_of(ChosenCells.of(cells.rows), CENTRE):
        yield _at_probes(cells, numbers, cells.corner_values(nodal, numbers), u)


def _at_probes(cells: MeshCells, numbers: IntArray, values: Array, u: Field) -> tuple[float, ...]:
    """The errors at the probes of some cells; ``values`` are u at the corners."""
    corners = cells.corners(numbers)
    low, high, found = np.inf, -np.inf, (0.0, np.nan, np.nan)
    for probe in range(max(1, min(MAX_PROBES_PER_CELL, PROBES // cells.count))):
        steps = probe * cells.count + numbers + 1.0
        weights = _weights(np.asarray(SHARES[0] * steps) % 1.0, np.asarray(SHARES[1] * steps) % 1.0)
        x, y = (np.einsum("ck,ck->k", weights, corners[part]) for part in (slice(0, 4), slice(4, 8)))
        there = u.evaluate(x, y)[0]
        error = np.abs(np.einsum("ck,ck->k", weights, values) - there)
        error[~np.isfinite(error)] = 0.0
        low, high = min(low, float(np.nanmin(there))), max(high, float(np.nanmax(there)))
        worst = int(error.argmax())
        if error[worst] > found[0]:
            found = float(error[worst]), float(x[worst]), float(y[worst])
    return low, high, *found


def _weights(s: Array, t: Array) -> Array:
    """The bilinear weights of the corners at (s, t), counter-clockwise, of shape ``(4, n)``."""
    return np.stack([(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t])
