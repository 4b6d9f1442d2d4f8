"""How well a mesh interpolates u, compared with the uniform mesh of its size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import IntArray
from equimesh.quality.cells import BilinearCells, CellPoints
from equimesh.quality.pieces import Pieces, add_gradients, add_values
from equimesh.quality.resolution import resolved_integrals

MIN_SAMPLED_CELLS = 30_000
"""Cells that :func:`interpolation_errors` samples, or up to three times as many; on smaller meshes all cells."""
SAMPLING = ((34, 13), (13, 5), (5, 2))  # one cell of this many; the shift from row to row
ROUNDING_SHARE = 1e-13
"""Share of u that counts as rounding in its values."""
CORNERS = CellPoints(np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0]), np.full(4, 0.25))
"""The corners of a cell, counter-clockwise."""
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

    Of :func:`~equimesh.quality.triangles.triangle_errors` it is that of the linear interpolant on triangles.

    ``l2`` is the norm of ``u - u_h``, ``h1`` that of ``grad u - grad u_h``; both over the whole domain, in the units of
    u and of its gradient times a length. Infinite on a folded mesh. ``rounding`` is the part of the two that is due to
    rounding. ``size`` is the largest size of u at a corner, ``variation`` the largest value of u at the points of
    quadrature minus the smallest one, ``largest`` the largest error there on this mesh; NaN and ``None`` on a folded
    mesh. ``resolved`` says of each norm whether two rules of quadrature agree to 5 % on both meshes.
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

    def estimated_gain(self, norm: str) -> float:
        """The gain in ``norm``, ``"l2"`` or ``"h1"``, by the best estimate of the errors: also where not resolved."""
        if norm == "l2":
            return _gain(self.l2_uniform, self.l2, self.rounding[0])
        return _gain(self.h1_uniform, self.h1, self.rounding[1])


@dataclass(frozen=True, eq=False)
class ErrorRule:
    """Quadrature of squared errors: u and its gradient at ``inner`` points, u alone at ``edge`` points of every cell.

    Gradients are weighted by ``inner.weights``, values by those and by ``edge.weights``.
    """

    inner: CellPoints
    edge: CellPoints

    @classmethod
    def gauss(cls, count: int) -> ErrorRule:
        """The Gauss rule with ``count`` points per direction, alone."""
        return cls(CellPoints.gauss(count), CellPoints(np.empty(0), np.empty(0), np.empty(0)))

    @classmethod
    def lean(cls) -> ErrorRule:
        """The 2 x 2 Gauss rule, and the middles of the edges.

        The interpolation error is ``a s (1-s) + b t (1-t)`` to leading order. Its square has the integral
        ``(a^2 + b^2)/30 + a b/18``, of which the 2 x 2 rule gives ``(a + b)^2/36``. Four middles with weights of
        2/45 add the rest. The result is exact to leading order; for the gradient the 2 x 2 rule alone is. The weights
        sum to more than 1: the corners, where there is no error, have the negative rest.
        """
        middles = CellPoints(
            np.array([0.5, 1.0, 0.5, 0.0]),
            np.array([0.0, 0.5, 1.0, 0.5]),
            np.full(4, 2 / 45),
        )
        return cls(CellPoints.gauss(2), middles)


def interpolation_errors(mesh: Mesh, u: Field, uniform: Mesh | None = None) -> InterpolationErrors:
    """The interpolation errors of u on ``mesh`` and on ``uniform``, at the cost of a small part of a solve.

    ``uniform`` is the uniform mesh of the domain, by default of the unit square. On more than 150 000 cells the norms
    are estimated from every 5th, 13th or 34th of them, in a pattern that meets every row and column of
    the mesh: to about a percent.
    """
    uniform = Mesh.uniform(mesh.grid) if uniform is None else uniform
    with np.errstate(all="ignore"):
        first, second = BilinearCells(mesh), BilinearCells(uniform)
        return errors_of(first, second, u, ErrorRule.lean(), sample(first.shape))


def errors_of(
    cells: BilinearCells, uniform: BilinearCells, u: Field, rule: ErrorRule, numbers: IntArray | None = None
) -> InterpolationErrors:
    """The errors on two meshes of one size by ``rule``, from all cells or from the :func:`sample` with ``numbers``."""
    return compared(cells, _norms(cells, u, rule, numbers), _norms(uniform, u, rule, numbers))


class Norms(NamedTuple):
    """L2 norm and H1 seminorm of an error, the largest value of u at a corner, and whether the two are resolved."""

    l2: float
    h1: float
    size: float
    resolved: tuple[bool, bool] = (True, True)
    variation: float = math.nan
    largest: LargestError | None = None


def compared(cells: BilinearCells, here: Norms, there: Norms) -> InterpolationErrors:
    """The errors ``here``, on ``cells``, next to those ``there``, on the uniform mesh."""
    return InterpolationErrors(
        l2=here.l2,
        l2_uniform=there.l2,
        h1=here.h1,
        h1_uniform=there.h1,
        rounding=noise(cells, here.size),
        size=here.size,
        variation=here.variation,
        largest=here.largest,
        resolved=(here.resolved[0] and there.resolved[0], here.resolved[1] and there.resolved[1]),
    )


def _norms(cells: BilinearCells, u: Field, rule: ErrorRule, numbers: IntArray | None) -> Norms:
    """The norms of u minus its Q1 interpolant: by ``rule``, or by a finer one where a second rule does not agree."""
    if not cells.all_valid:
        return Norms(math.inf, math.inf, math.nan)
    nodal = None if numbers is not None else u.evaluate(*cells.nodes)[0]
    known, done = np.arange(cells.count) if numbers is None else numbers, 0
    values, sums, largest = np.empty((4, known.size)), np.zeros((2, known.size)), np.zeros(known.size)
    low, high = math.inf, -math.inf
    for block in cells.blocks(rule.inner, numbers):
        here = slice(done, done + block.size)
        done += block.size
        if nodal is None:
            at = cells.at(CORNERS, block)
            (values[:, here],) = u.evaluate(at.x, at.y)
        else:
            values[:, here] = cells.corner_values(nodal, block)
        corner, parts = np.ascontiguousarray(values[:, here]), np.zeros((4, block.size))
        at = cells.at(rule.inner, block)
        there, u_x, u_y = u.evaluate(at.x, at.y, order=1)
        add_values(corner, there, rule.inner, at.det, parts[0], largest[here])
        add_gradients(corner, (u_x, u_y), rule.inner, at, parts[1], parts[2:])
        if rule.edge.s.size:
            at = cells.at(rule.edge, block)
            (there,) = u.evaluate(at.x, at.y)
            add_values(corner, there, rule.edge, at.det, parts[0], largest[here])
        low, high = min(low, float(there.min())), max(high, float(there.max()))
        sums[:, here] = parts[:2]
    size = float(np.abs(values).max())
    allowed = noise(cells, size)
    squares = (allowed[0] * allowed[0], allowed[1] * allowed[1])
    found = resolved_integrals(Pieces.of(cells, known, values), cells.shape, known, sums, u, squares)
    l2, h1 = (math.sqrt(square * cells.count / known.size) for square in found.squares)
    worst, known_range = int(largest.argmax()), (min(low, float(values.min())), max(high, float(values.max())))
    at = cells.at(CENTRE, known[worst : worst + 1])
    peak = LargestError(float(largest[worst]), float(at.x[0, 0]), float(at.y[0, 0]))
    return Norms(l2, h1, size, found.resolved, known_range[1] - known_range[0], peak)


def noise(cells: BilinearCells, size: float) -> tuple[float, float]:
    """The parts of the two norms that rounding causes, where ``size`` is the largest value of u."""
    of_values = ROUNDING_SHARE * size * math.sqrt(abs(cells.total_area)) if math.isfinite(size) else 0.0
    finest = max(cells.shape) / math.sqrt(abs(cells.total_area) or 1.0)
    return of_values, 10.0 * of_values * finest


def sample(shape: tuple[int, int]) -> IntArray | None:
    """Numbers of the sampled cells: a lattice with the same share of every row and column."""
    count = shape[0] * shape[1]
    for one_of, shift in SAMPLING:
        if count >= one_of * MIN_SAMPLED_CELLS:
            first = (-shift * np.arange(shape[0])) % one_of
            rows = [np.arange(start, shape[1], one_of) + row * shape[1] for row, start in enumerate(first)]
            return np.concatenate(rows).astype(np.int64)
    return None


def _gain(uniform: float, adapted: float, rounding: float) -> float:
    if max(uniform, adapted) <= rounding:
        return 1.0
    return uniform / adapted if adapted > 0.0 else math.inf
