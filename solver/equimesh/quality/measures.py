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
from typing import Any, Literal, NamedTuple

import numpy as np

from equimesh.fields.field import Field
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array
from equimesh.quality.cell_shapes import alignments, angles_and_edges, regularities, size_ratios
from equimesh.quality.cells import BilinearCells, CellPoints
from equimesh.quality.interpolation import ErrorRule, InterpolationErrors, errors_of, interpolation_errors
from equimesh.quality.triangles import triangle_errors

GAUSS_POINTS = ((512, 8), (2500, 3))
"""Gauss points per direction and cell, on meshes of at most this many cells: ``(cells, points)``."""
GAUSS_POINTS_BEYOND = 2
"""On larger meshes, where the monitor hardly varies within a cell."""


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
    """The mesh's smallest corner Jacobian over the mesh's area, scaled so that a mesh of equal parallelograms has 1."""
    min_jacobian_over_mean: float
    """The smallest corner Jacobian over the mean one: the same number, since the mean is the mean area of a cell."""
    interpolation_error: InterpolationErrors | None
    """How well u is interpolated; ``None`` for a monitor without u."""

    def summary(self, *, arrays: bool = False) -> dict[str, Any]:
        """The measures as nested plain Python data, ready for JSON.

        Every per-cell measure becomes ``{"max", "min", "mean", "rms"}`` and, with ``arrays``, ``"cells"``:
        nested lists, xi first. A number that is not finite becomes ``None``, since JSON has no infinity.
        """
        result: dict[str, Any] = {}
        for name in PER_CELL:
            measured: Measure = getattr(self, name)
            result[name] = {kind: finite_or_none(getattr(measured, kind)) for kind in ("max", "min", "mean", "rms")}
            if arrays:
                result[name]["cells"] = [[finite_or_none(value) for value in row] for row in measured.cells.tolist()]
        for name in ("min_jacobian", "min_jacobian_over_mean"):
            result[name] = finite_or_none(getattr(self, name))
        error = self.interpolation_error
        names = ("l2", "l2_uniform", "gain_l2", "h1", "h1_uniform", "gain_h1")
        result["interpolation_error"] = error and {name: finite_or_none(getattr(error, name)) for name in names}
        return result


PER_CELL = ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures of :class:`Quality` that have one value per cell."""


@dataclass(frozen=True, eq=False)
class CellMetrics:
    """The mean of a monitor's exact metric over every cell, as arrays over the ``cells``; nan on folded ones."""

    cells: BilinearCells
    m11: Array
    m12: Array
    m22: Array

    @classmethod
    def of(cls, mesh: Mesh, monitor: Monitor, *, gauss: int | None = None) -> CellMetrics:
        """The means by Gauss quadrature; ``gauss`` as in :func:`measure`."""
        with np.errstate(all="ignore"):
            cells = BilinearCells(mesh)
            rule = CellPoints.gauss(_gauss_points(cells, gauss))
            mean = np.full((3, cells.count), np.nan)
            for block in cells.blocks(rule):
                x, y, share = cells.shares(rule, block)
                for row, entry in enumerate(monitor.metric(x, y)):
                    mean[row, block] = np.einsum("pk,pk->k", share, entry)
        return cls(cells, *mean)

    def q_eq(self) -> Array:
        """:func:`equidistribution` of every cell."""
        cells = self.cells
        with np.errstate(all="ignore"):
            size = self.m11 * self.m22
            size -= self.m12 * self.m12
            np.sqrt(size, out=size)
            size *= cells.area
            size *= cells.count / size.sum(where=cells.valid)
        size[~cells.valid] = np.inf
        return size.reshape(cells.shape)

    def q_ali(self) -> Array:
        """:func:`alignment` of every cell."""
        result = np.empty(self.cells.count)
        alignments(*self.cells.nodes, self.cells.valid, self.m11, self.m12, self.m22, result)
        return result.reshape(self.cells.shape)


class MonitorMeasures(NamedTuple):
    """The measures of every cell that depend on the monitor."""

    q_eq: Array
    q_ali: Array

    @classmethod
    def of(cls, mesh: Mesh, monitor: Monitor, *, gauss: int | None = None) -> MonitorMeasures:
        """The measures by Gauss quadrature; ``gauss`` as in :func:`measure`."""
        metrics = CellMetrics.of(mesh, monitor, gauss=gauss)
        return cls(metrics.q_eq(), metrics.q_ali())


def measure(mesh: Mesh, monitor: Monitor, *, uniform: Mesh | None = None, gauss: int | None = None) -> Quality:
    """All quality measures of ``mesh`` for ``monitor``, which must be bound to a domain if it depends on one.

    ``uniform`` is the mesh of the same size that interpolation of u is compared with, by default the uniform mesh of
    the unit square. ``gauss`` is the number of Gauss points per direction and cell; by default ``GAUSS_POINTS`` or, on
    many cells, ``GAUSS_POINTS_BEYOND``, where the interpolation errors are those of
    :func:`~equimesh.quality.interpolation.interpolation_errors`. Not finite where u or its gradient is not.
    """
    interpolation = measure_interpolation(mesh, monitor.u, uniform=uniform, gauss=gauss)
    return complete_quality(mesh, MonitorMeasures.of(mesh, monitor, gauss=gauss), interpolation)


def complete_quality(mesh: Mesh, measures: MonitorMeasures, interpolation: InterpolationErrors | None) -> Quality:
    """All quality measures of ``mesh``: those that are given, and those of its geometry."""
    with np.errstate(all="ignore"):
        cells = BilinearCells(mesh)
        sine, skewness, aspect_ratio = (np.empty(cells.count) for _ in range(3))
        angles_and_edges(*cells.nodes, cells.valid, sine, skewness, aspect_ratio)
        ratios = np.empty(cells.count)
        size_ratios(*cells.shape, cells.valid, cells.area, ratios)
        return Quality(
            q_eq=Measure(measures.q_eq),
            q_ali=Measure(measures.q_ali),
            q_geo=Measure(_regularity(cells)),
            scaled_jacobian=Measure(sine.reshape(cells.shape)),
            skewness=Measure(skewness.reshape(cells.shape)),
            aspect_ratio=Measure(aspect_ratio.reshape(cells.shape)),
            size_ratio=Measure(ratios.reshape(cells.shape)),
            min_jacobian=float(np.float64(cells.lowest) * cells.count / abs(cells.total_area)),
            min_jacobian_over_mean=float(np.float64(cells.lowest) / (cells.total_area / cells.count)),
            interpolation_error=interpolation,
        )


def equidistribution(mesh: Mesh, monitor: Monitor, *, gauss: int | None = None) -> Array:
    """``Q_eq`` of every cell: its share of the metric's total area, in units of the mean share.

    ``Q_eq(K) = N |K| sqrt(det M_K) / sum over K of |K| sqrt(det M_K)``, N the number of cells, M_K the mean
    over the bilinear quadrilateral K of the monitor's exact metric (Huang and Russell, chapter 4; Haynes and
    Howse, Table 1, prints the maximum). Positive, of mean 1; all are 1 exactly when M is equidistributed.
    Folded cells are infinite and left out of the sum. ``gauss`` as in :func:`measure`.
    """
    return CellMetrics.of(mesh, monitor, gauss=gauss).q_eq()


def alignment(mesh: Mesh, monitor: Monitor, *, gauss: int | None = None) -> Array:
    """``Q_ali`` of every cell: how far its shape is from a square in the metric M_K.

    ``Q_ali = tr(F'^T M_K F') / (2 sqrt(det M_K) det F')`` (Huang and Russell, chapter 4), F' the Jacobian
    matrix of the bilinear map of the unit square onto the cell. F' varies over the cell: the value is the
    largest, which is that of a corner. At least 1.
    """
    return CellMetrics.of(mesh, monitor, gauss=gauss).q_ali()


def shape_regularity(mesh: Mesh) -> Array:
    """``Q_geo`` of every cell: :func:`alignment` with the identity for the metric.

    At least 1, and 1 for a square; ``(r + 1/r) / 2`` for a rectangle of sides in the ratio r.
    """
    with np.errstate(all="ignore"):
        return _regularity(BilinearCells(mesh))


def _gauss_points(cells: BilinearCells, gauss: int | None) -> int:
    return gauss or next((points for most, points in GAUSS_POINTS if cells.count <= most), GAUSS_POINTS_BEYOND)


def _regularity(cells: BilinearCells) -> Array:
    result = np.empty(cells.count)
    regularities(*cells.nodes, cells.valid, result)
    return result.reshape(cells.shape)


def measure_interpolation(
    mesh: Mesh,
    u: Field | None,
    *,
    uniform: Mesh | None = None,
    gauss: int | None = None,
    kind: Literal["quad", "triangle"] = "quad",
) -> InterpolationErrors | None:
    """How well u is interpolated, ``None`` where there is no u; the arguments are those of :func:`measure`.

    With ``kind = "triangle"`` it is interpolated linearly on triangles.
    """
    if u is None:
        return None
    if kind == "triangle":
        return triangle_errors(mesh, u, uniform)
    cells = BilinearCells(mesh)
    points = _gauss_points(cells, gauss)
    if gauss is None and points == GAUSS_POINTS_BEYOND:
        return interpolation_errors(mesh, u, uniform)
    reference = BilinearCells(Mesh.uniform(mesh.grid) if uniform is None else uniform)
    with np.errstate(all="ignore"):
        return errors_of(cells, reference, u, ErrorRule.gauss(points))
