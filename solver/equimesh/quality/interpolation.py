"""How well a mesh interpolates u, compared with the uniform mesh of its size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.cells import BilinearCells, CellMap, CellPoints

MIN_SAMPLED_CELLS = 30_000
"""Cells that :func:`interpolation_errors` samples, or up to three times as many; on smaller meshes all cells."""
SAMPLING = ((34, 13), (13, 5), (5, 2))  # one cell of this many; the shift from row to row
ROUNDING_SHARE = 1e-13
"""Share of u that counts as rounding in its values."""


@dataclass(frozen=True, kw_only=True)
class InterpolationErrors:
    """Error of the isoparametric Q1 interpolant of u, on the mesh and on the uniform one of its size.

    ``l2`` is the norm of ``u - u_h``, ``h1`` that of ``grad u - grad u_h``; both over the whole domain, in the units of
    u and of its gradient times a length. Infinite on a folded mesh. ``rounding`` is the part of the two that is due to
    rounding.
    """

    l2: float
    l2_uniform: float
    h1: float
    h1_uniform: float
    rounding: tuple[float, float] = (0.0, 0.0)

    @property
    def gain_l2(self) -> float:
        """``l2_uniform / l2``: how many times smaller the error is than on the uniform mesh; below 1 it is larger."""
        return _gain(self.l2_uniform, self.l2, self.rounding[0])

    @property
    def gain_h1(self) -> float:
        """``h1_uniform / h1``."""
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
    l2, h1, size = _norms(cells, u, rule, numbers)
    l2_uniform, h1_uniform, _ = _norms(uniform, u, rule, numbers)
    noise = ROUNDING_SHARE * size * math.sqrt(abs(cells.total_area)) if math.isfinite(size) else 0.0
    finest = max(cells.shape) / math.sqrt(abs(cells.total_area) or 1.0)
    return InterpolationErrors(
        l2=l2, l2_uniform=l2_uniform, h1=h1, h1_uniform=h1_uniform, rounding=(noise, 10.0 * noise * finest)
    )


def _norms(cells: BilinearCells, u: Field, rule: ErrorRule, numbers: IntArray | None) -> tuple[float, float, float]:
    """L2 norm and H1 seminorm of u minus its Q1 interpolant, and the largest value of u at the corners."""
    if not cells.all_valid:
        return math.inf, math.inf, math.nan
    nodal = None if numbers is not None else u.evaluate(*cells.nodes)[0]
    corners = CellPoints(np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0]), np.full(4, 0.25))
    sums, size = np.zeros(2), 0.0
    for block in cells.blocks(rule.inner, numbers):
        if nodal is None:
            at = cells.at(corners, block)
            (values,) = u.evaluate(at.x, at.y)
        else:
            values = cells.corner_values(nodal, block)
        size = max(size, float(np.abs(values).max()))
        at = cells.at(rule.inner, block)
        there, u_x, u_y = u.evaluate(at.x, at.y, order=1)
        add_values(values, there, rule.inner, at.det, sums)
        add_gradients(values, (u_x, u_y), rule.inner, at, sums)
        if rule.edge.s.size:
            at = cells.at(rule.edge, block)
            (there,) = u.evaluate(at.x, at.y)
            add_values(values, there, rule.edge, at.det, sums)
    share = 1.0 if numbers is None else numbers.size / cells.count
    return math.sqrt(sums[0] / share), math.sqrt(sums[1] / share), size


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


@compiled
def add_values(corner: Array, u: Array, points: CellPoints, det: Array, sums: Array) -> None:
    """To ``sums[0]`` the weighted squares of the bilinear interpolant of ``corner`` values minus ``u``."""
    s, t, weights = points
    total = 0.0
    for p in range(u.shape[0]):
        a, b, c, d = (1.0 - s[p]) * (1.0 - t[p]), s[p] * (1.0 - t[p]), s[p] * t[p], (1.0 - s[p]) * t[p]
        for k in range(u.shape[1]):
            error = a * corner[0, k] + b * corner[1, k] + c * corner[2, k] + d * corner[3, k] - u[p, k]
            total += weights[p] * det[p, k] * error * error
    sums[0] += total


@compiled
def add_gradients(corner: Array, gradient: Pair, points: CellPoints, at: CellMap, sums: Array) -> None:
    """To ``sums[1]`` the weighted squares of the gradient of the interpolant minus that of u."""
    (u_x, u_y), (s, t, weights) = gradient, points
    _, _, x_s, y_s, x_t, y_t, det = at
    total = 0.0
    for p in range(u_x.shape[0]):
        for k in range(u_x.shape[1]):
            along_s = (1.0 - t[p]) * (corner[1, k] - corner[0, k]) + t[p] * (corner[2, k] - corner[3, k])
            along_t = (1.0 - s[p]) * (corner[3, k] - corner[0, k]) + s[p] * (corner[2, k] - corner[1, k])
            per_det = 1.0 / det[p, k]
            error_x = (along_s * y_t[p, k] - along_t * y_s[p, k]) * per_det - u_x[p, k]
            error_y = (along_t * x_s[p, k] - along_s * x_t[p, k]) * per_det - u_y[p, k]
            total += weights[p] * det[p, k] * (error_x * error_x + error_y * error_y)
    sums[1] += total
