"""How good a mesh is: for its monitor, in its geometry, and for interpolating u.

``Q_eq``, ``Q_ali`` and ``Q_geo`` are those of Huang and Russell, *Adaptive Moving Mesh Methods* (Springer,
2011), chapter 4, in two dimensions and on quadrilaterals; ``Q_eq`` is what Haynes and Howse print in Table 1.
All measures are dimensionless. Per-cell arrays have shape ``(n_xi - 1, n_eta - 1)``.

On a folded cell nothing is equidistributed, aligned or interpolated: ``Q_eq``, ``Q_ali``, ``Q_geo`` and
``size_ratio`` are infinite there, and a mesh with such a cell has infinite interpolation errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.bilinear import BilinearCells, CellPoints
from equimesh.mesh import Mesh
from equimesh.monitor import ArcLength

Array: TypeAlias = npt.NDArray[np.float64]

GAUSS_POINTS = 8
"""Gauss points per direction and cell, on meshes of at most ``MANY_CELLS`` cells."""
GAUSS_POINTS_MANY = 4
"""Gauss points per direction and cell on larger meshes, whose cells see less of the monitor's variation."""
MANY_CELLS = 4096


@dataclass(frozen=True, eq=False)
class Measure:
    """One number per cell, ``cells``, with its extremes and means over the cells."""

    cells: Array

    @property
    def max(self) -> float:
        """The largest over the cells."""
        return float(self.cells.max())

    @property
    def min(self) -> float:
        """The smallest over the cells."""
        return float(self.cells.min())

    @property
    def mean(self) -> float:
        """The mean over the cells, each cell counting once."""
        return float(self.cells.mean())

    @property
    def rms(self) -> float:
        """The root mean square over the cells."""
        return math.sqrt(float(np.mean(self.cells**2)))


@dataclass(frozen=True, kw_only=True)
class InterpolationError:
    """Error of the isoparametric Q1 interpolant of u, on the mesh and on the uniform one of its size.

    ``l2`` is the norm of ``u - u_h``, ``h1`` that of ``grad u - grad u_h``; both over the whole domain.
    """

    l2: float
    l2_uniform: float
    h1: float
    h1_uniform: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Quality:
    """All measures of one mesh, as :func:`measure` returns them."""

    q_eq: Measure
    """Equidistribution, 1 best: see :func:`equidistribution`. Its mean over the cells is 1."""
    q_ali: Measure
    """Alignment with the metric, >= 1 and 1 best: see :func:`alignment`."""
    q_geo: Measure
    """Closeness of the cells to squares, >= 1 and 1 best: see :func:`shape_regularity`."""
    scaled_jacobian: Measure
    """Smallest sine of the four corner angles, in [-1, 1]: 1 for a rectangle, at most 0 on a folded cell."""
    skewness: Measure
    """Equiangle skewness ``max(t_max - 90, 90 - t_min) / 90`` of the corner angles t in degrees, in [0, 1]:
    0 for a rectangle, 1 for a degenerate or folded cell."""
    aspect_ratio: Measure
    """Longest edge of the cell over its shortest, >= 1; infinite when an edge has no length."""
    size_ratio: Measure
    """Larger area over smaller for a cell and an edge neighbour, the largest over its neighbours, >= 1."""
    min_jacobian: float
    """The mesh's smallest corner Jacobian, scaled so that the uniform mesh of the unit square has 1."""
    min_jacobian_over_mean: float
    """The same over the mean corner Jacobian, hence independent of the size of the domain."""
    interpolation_error: InterpolationError

    def summary(self, *, arrays: bool = False) -> dict[str, Any]:
        """The measures as nested plain Python data, ready for JSON.

        Every per-cell measure becomes ``{"max", "min", "mean", "rms"}`` and, with ``arrays``, ``"cells"``:
        nested lists, xi first. A number that is not finite becomes ``None``, since JSON has no infinity.
        """
        result: dict[str, Any] = {}
        for name in PER_CELL:
            measured: Measure = getattr(self, name)
            result[name] = {kind: _plain(getattr(measured, kind)) for kind in ("max", "min", "mean", "rms")}
            if arrays:
                result[name]["cells"] = [[_plain(value) for value in row] for row in measured.cells.tolist()]
        for name in ("min_jacobian", "min_jacobian_over_mean"):
            result[name] = _plain(getattr(self, name))
        error = self.interpolation_error
        result["interpolation_error"] = {
            name: _plain(getattr(error, name)) for name in ("l2", "l2_uniform", "h1", "h1_uniform")
        }
        return result


PER_CELL = ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures of :class:`Quality` that have one value per cell."""


def measure(mesh: Mesh, monitor: ArcLength, *, gauss: int | None = None) -> Quality:
    """All quality measures of ``mesh`` for ``monitor``.

    ``gauss`` is the number of Gauss points per direction and cell; by default ``GAUSS_POINTS``, or
    ``GAUSS_POINTS_MANY`` on more than ``MANY_CELLS`` cells. Not finite where u or its gradient is not.
    """
    with np.errstate(all="ignore"):
        cells = BilinearCells(mesh)
        metric = _mean_metric(cells, monitor, gauss)
        sine, skewness, aspect_ratio = _angles_and_edges(cells)
        l2, h1 = _interpolation_error(cells, monitor, gauss)
        l2_uniform, h1_uniform = _interpolation_error(BilinearCells(Mesh.uniform(mesh.grid)), monitor, gauss)
        return Quality(
            q_eq=Measure(_equidistribution(cells, metric)),
            q_ali=Measure(_alignment(cells, metric)),
            q_geo=Measure(shape_regularity(mesh)),
            scaled_jacobian=Measure(sine),
            skewness=Measure(skewness),
            aspect_ratio=Measure(aspect_ratio),
            size_ratio=Measure(_size_ratio(cells)),
            min_jacobian=mesh.min_jacobian,
            min_jacobian_over_mean=float(cells.dets.min() / cells.dets.mean()),
            interpolation_error=InterpolationError(l2=l2, l2_uniform=l2_uniform, h1=h1, h1_uniform=h1_uniform),
        )


def equidistribution(mesh: Mesh, monitor: ArcLength, *, gauss: int | None = None) -> Array:
    """``Q_eq`` of every cell: its share of the metric's total area, in units of the mean share.

    ``Q_eq(K) = N |K| sqrt(det M_K) / sum over K of |K| sqrt(det M_K)``, N the number of cells, M_K the mean
    over the bilinear quadrilateral K of the monitor's exact metric (Huang and Russell, chapter 4; Haynes and
    Howse, Table 1, prints the maximum). Positive, of mean 1; all are 1 exactly when M is equidistributed.
    Folded cells are infinite and left out of the sum. ``gauss`` as in :func:`measure`.
    """
    with np.errstate(all="ignore"):
        cells = BilinearCells(mesh)
        return _equidistribution(cells, _mean_metric(cells, monitor, gauss))


def alignment(mesh: Mesh, monitor: ArcLength, *, gauss: int | None = None) -> Array:
    """``Q_ali`` of every cell: how far its shape is from a square in the metric M_K.

    ``Q_ali = tr(F'^T M_K F') / (2 sqrt(det M_K) det F')`` (Huang and Russell, chapter 4), F' the Jacobian
    matrix of the bilinear map of the unit square onto the cell. F' varies over the cell: the value is the
    largest of those at the four corners and the 2 x 2 Gauss points. At least 1.
    """
    with np.errstate(all="ignore"):
        cells = BilinearCells(mesh)
        return _alignment(cells, _mean_metric(cells, monitor, gauss))


def shape_regularity(mesh: Mesh) -> Array:
    """``Q_geo`` of every cell: :func:`alignment` with the identity for the metric.

    At least 1, and 1 for a square; ``(r + 1/r) / 2`` for a rectangle of sides in the ratio r.
    """
    with np.errstate(all="ignore"):
        cells = BilinearCells(mesh)
        one = np.ones(cells.count)
        return _alignment(cells, (one, np.zeros(cells.count), one))


_Metric: TypeAlias = tuple[Array, Array, Array]  # m11, m12, m22 of every cell


def _rule(cells: BilinearCells, gauss: int | None) -> CellPoints:
    return CellPoints.gauss(gauss or (GAUSS_POINTS if cells.count <= MANY_CELLS else GAUSS_POINTS_MANY))


def _mean_metric(cells: BilinearCells, monitor: ArcLength, gauss: int | None) -> _Metric:
    """The mean of the exact metric over every cell by Gauss quadrature; nan on folded cells."""
    rule = _rule(cells, gauss)
    mean = np.full((3, cells.count), np.nan)
    for block in cells.blocks(rule):
        at = cells.at(rule, block)
        share = rule.weights[:, None] * at.det / cells.area[block]
        for row, entry in enumerate(monitor.metric(at.x, at.y)):
            mean[row, block] = (share * entry).sum(axis=0)
    return mean[0], mean[1], mean[2]


def _equidistribution(cells: BilinearCells, metric: _Metric) -> Array:
    m11, m12, m22 = metric
    size = cells.area * np.sqrt(m11 * m22 - m12**2)
    relative = size * cells.count / size[cells.valid].sum()
    return np.where(cells.valid, relative, np.inf).reshape(cells.shape)


def _alignment(cells: BilinearCells, metric: _Metric) -> Array:
    points, worst = CellPoints.samples(), np.full(cells.count, np.inf)
    for block in cells.blocks(points):
        at = cells.at(points, block)
        m11, m12, m22 = (entry[block] for entry in metric)
        cross = at.x_s * at.y_s + at.x_t * at.y_t
        trace = m11 * (at.x_s**2 + at.x_t**2) + 2 * m12 * cross + m22 * (at.y_s**2 + at.y_t**2)
        worst[block] = (trace / (2 * np.sqrt(m11 * m22 - m12**2) * at.det)).max(axis=0)
    return worst.reshape(cells.shape)


def _angles_and_edges(cells: BilinearCells) -> tuple[Array, Array, Array]:
    """Scaled Jacobian, equiangle skewness and aspect ratio of every cell."""
    out_x, out_y = (np.roll(corner, -1, axis=0) - corner for corner in (cells.x, cells.y))  # edge after a corner
    back_x, back_y = -np.roll(out_x, 1, axis=0), -np.roll(out_y, 1, axis=0)  # from it along the edge before
    cross, dot = out_x * back_y - out_y * back_x, out_x * back_x + out_y * back_y
    length = np.hypot(out_x, out_y)
    product = length * np.roll(length, 1, axis=0)
    sine = np.where(product > 0, cross / product, 0.0).min(axis=0)
    angle = np.arctan2(cross, dot) / (np.pi / 2)
    skewness = np.where(cells.valid, np.abs(angle - 1.0).max(axis=0), 1.0)
    shortest = length.min(axis=0)
    aspect_ratio = np.where(shortest > 0, length.max(axis=0) / shortest, np.inf)
    return sine.reshape(cells.shape), skewness.reshape(cells.shape), aspect_ratio.reshape(cells.shape)


def _size_ratio(cells: BilinearCells) -> Array:
    area = np.where(cells.valid, cells.area, 0.0).reshape(cells.shape)
    ratio = np.where(area > 0, 1.0, np.inf)
    for sizes, largest in ((area, ratio), (area.T, ratio.T)):  # neighbours along xi, then along eta
        small, large = np.minimum(sizes[1:], sizes[:-1]), np.maximum(sizes[1:], sizes[:-1])
        step = np.where(small > 0, large / small, np.inf)
        np.maximum(largest[1:], step, out=largest[1:])
        np.maximum(largest[:-1], step, out=largest[:-1])
    return ratio


def _interpolation_error(cells: BilinearCells, monitor: ArcLength, gauss: int | None) -> tuple[float, float]:
    """L2 norm and H1 seminorm of u minus its Q1 interpolant."""
    if not cells.valid.all():
        return math.inf, math.inf
    rule = _rule(cells, gauss)
    nodal = cells.corners(monitor.u.evaluate(cells.mesh.x, cells.mesh.y)[0])
    l2 = h1 = 0.0
    for block in cells.blocks(rule):
        at, corner = cells.at(rule, block), nodal[:, block]
        u, u_x, u_y = monitor.u.evaluate(at.x, at.y, order=1)
        u_s, u_t = rule.shape_s @ corner, rule.shape_t @ corner
        error_x = (u_s * at.y_t - u_t * at.y_s) / at.det - u_x
        error_y = (u_t * at.x_s - u_s * at.x_t) / at.det - u_y
        weights = rule.weights[:, None] * at.det
        l2 += float((weights * (rule.shape @ corner - u) ** 2).sum())
        h1 += float((weights * (error_x**2 + error_y**2)).sum())
    return math.sqrt(l2), math.sqrt(h1)


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
