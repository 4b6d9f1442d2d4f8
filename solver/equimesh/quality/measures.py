"""The quality of a mesh: for its monitor, in its geometry, and for interpolating u.

``Q_eq``, ``Q_ali`` and ``Q_geo`` are defined by Huang and Russell, *Adaptive Moving Mesh Methods* (Springer,
2011), chapter 4; here they are used in two dimensions and on quadrilaterals. Table 1 of Haynes and Howse has ``Q_eq``.
All measures are dimensionless. Per-cell arrays have shape ``(n_xi - 1, n_eta - 1)``, or ``(m,)`` on a mesh of blocks.

On a folded cell nothing is equidistributed, aligned or interpolated: ``Q_eq``, ``Q_ali``, ``Q_geo`` and
``size_ratio`` are infinite there, and a mesh with such a cell has infinite interpolation errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Chords
from equimesh.domains.domain import UNIT_SQUARE, Domain, Rectangle, closed_of, cut_off, map_mesh, most_cut_off
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh, MeshRows
from equimesh.monitors.monitor import Monitor, require_monitor
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import (
    AnyMesh,
    BilinearCells,
    CellPoints,
    Cells,
    MeshCells,
    UniformCells,
    cells_of,
)
from equimesh.quality.degrees import degree_errors
from equimesh.quality.interpolation import (
    UNKNOWN,
    InterpolationErrors,
    Norms,
    compared,
    kept_of_uniform,
    norms,
    norms_of,
    require_same_cells,
    sample,
)
from equimesh.quality.shapes import SHAPES, Shapes
from equimesh.quality.survey import Survey
from equimesh.quality.tally import ErrorRule, ErrorTally

GAUSS_POINTS = ((512, 8), (2500, 3))
"""Gauss points per direction and cell, on meshes of at most this many cells: ``(cells, points)``."""
GAUSS_POINTS_BEYOND = 2
"""On larger meshes, where the monitor hardly varies within a cell."""
MAX_GAUSS_CELLS = 16_000
"""Beyond so many cells the metric is evaluated at the nodes, once for the cells around each, unless asked otherwise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Measure:
    """One number per cell, with its extremes and means over the cells, each cell counting once."""

    max: float
    """The largest over the cells."""
    min: float
    """The smallest over the cells."""
    mean: float
    """The mean over the cells."""
    rms: float
    """The root mean square over the cells."""
    compute: Callable[[], Array] = field(repr=False)
    """Computes :attr:`cells`."""

    @cached_property
    def cells(self) -> Array:
        """The numbers, one for each cell; on a large mesh they are computed when first used.

        Their shape is ``(n_xi - 1, n_eta - 1)``, or ``(m,)`` on a mesh of blocks. Where only some rows of a mesh are
        measured, they are the numbers of the own cells.
        """
        return self.compute()


@dataclass(frozen=True, kw_only=True, eq=False)
class Quality:
    """The measures of one mesh; see :func:`measure`."""

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
    """The errors of interpolating u; ``None`` for a monitor without u."""
    u: Array | None = field(default=None, repr=False)
    """u at the nodes that are here, if the measures needed it; ``None`` otherwise."""

    def without_cells(self) -> Quality:
        """The measures without the values of cells, small and ready to be sent to another process."""
        named = {name: replace(getattr(self, name), compute=_values_elsewhere) for name in PER_CELL}
        return replace(self, u=None, **named)

    def summary(self, *, arrays: bool = False) -> dict[str, Any]:
        """The measures as nested plain Python data, ready for JSON.

        Every per-cell measure becomes ``{"max", "min", "mean", "rms"}`` and, with ``arrays``, ``"cells"``:
        nested lists, xi first, or one list on a mesh of blocks. A number that is not finite becomes ``None``, since
        JSON has no infinity.
        """
        result: dict[str, Any] = {}
        for name in PER_CELL:
            measured: Measure = getattr(self, name)
            result[name] = {kind: finite_or_none(getattr(measured, kind)) for kind in ("max", "min", "mean", "rms")}
            if arrays:
                result[name]["cells"] = _plain(measured.cells.tolist())
        for name in ("min_jacobian", "min_jacobian_over_mean"):
            result[name] = finite_or_none(getattr(self, name))
        error = self.interpolation_error
        names = ("l2", "l2_uniform", "gain_l2", "h1", "h1_uniform", "gain_h1")
        result["interpolation_error"] = error and {name: finite_or_none(getattr(error, name)) for name in names}
        return result


def _plain(values: Any) -> Any:
    """Nested lists of numbers, with ``None`` for those that are not finite."""
    return [_plain(value) for value in values] if isinstance(values, list) else finite_or_none(values)


def _values_elsewhere() -> Array:
    raise InputError("the values of the cells are where the parts of the mesh are: ask for the numbers of the measure")


PER_CELL = ("q_eq", "q_ali", *SHAPES)
"""The measures of :class:`Quality` that have one value per cell."""


def measure(mesh: Mesh, monitor: Monitor, *, uniform: Mesh | None = None, gauss: int | None = None) -> Quality:
    """The quality measures of ``mesh`` for ``monitor``, which must be bound to a domain if it depends on one.

    ``uniform`` is the mesh of the same size that interpolation of u is compared with, by default the uniform mesh of
    the unit square; a mesh of blocks has none, and its gains are then NaN. ``gauss`` is the number of Gauss points
    per direction and cell; by default ``GAUSS_POINTS`` or, on many cells, ``GAUSS_POINTS_BEYOND``, where the
    interpolation errors are by :meth:`~equimesh.quality.tally.ErrorRule.lean`; from 16 000 cells on they are
    estimated from every 5th, 13th, 34th or 89th cell, most often to a percent, on the uniform mesh, too. Beyond
    ``MAX_GAUSS_CELLS`` the metric is that at the corners of the cells. Not finite where u or its gradient is not.
    """
    require_monitor(monitor)
    return measure_all(mesh, monitor, uniform=uniform, gauss=gauss)


def measure_each(
    mesh: Mesh, monitors: Sequence[Monitor], *, uniform: Mesh | None = None, gauss: int | None = None
) -> tuple[Quality, ...]:
    """As :func:`measure`, of each of several monitors: the shapes of the cells are measured once for all of them.

    A mesh that several fields share is measured by one monitor for each field.
    """
    for one in monitors:
        require_monitor(one)
    shapes = Shapes.of(cells_of(mesh))
    return tuple(measure_all(mesh, one, uniform=uniform, gauss=gauss, shapes=shapes) for one in monitors)


def measure_all(
    mesh: AnyMesh,
    monitor: Monitor,
    *,
    uniform: Mesh | None = None,
    domain: Domain = UNIT_SQUARE,
    gauss: int | None = None,
    kind: Literal["quad", "triangle"] = "quad",
    degree: int = 1,
    nodal: Array | None = None,
    errors: InterpolationErrors | None = None,
    shapes: Shapes | None = None,
    threads: int = 1,
) -> Quality:
    """As :func:`measure`, in ``threads`` if there are many cells.

    u is interpolated on cells of this ``kind`` by elements of this ``degree``; ``nodal`` is u at the nodes, ``errors``
    are those of interpolation, and ``shapes`` those of the mesh, where they are known. Without ``uniform`` the errors
    are compared with those on the uniform mesh of ``domain``, which must be valid.
    """
    with np.errstate(all="ignore"):
        if shapes is None:
            shapes = Shapes.of(cells_of(mesh, closed_of(domain)), threads=threads)
        cells, u, tally = shapes.cells, monitor.u, None
        rule = metric_rule(cells, gauss)
        numbers = sample(cells.rows) if gauss is None else None
        is_plain = errors is None and (kind, degree) == ("quad", 1) and cells.all_valid and numbers is None
        if u is not None and is_plain and rule is not CellPoints.corners():
            tally = ErrorTally.of(cells, u, error_rule(cells, gauss), nodal=nodal)
        survey = Survey.of(cells, monitor, rule, tally=tally, threads=threads)
        if nodal is None:
            nodal = survey.nodal if tally is None else tally.nodal
        if u is not None and errors is None:
            here = None
            if tally is not None:
                tally.add_edges()
                here = norms_of(tally)
            errors = _errors(
                cells, u, uniform, domain, (kind, degree), numbers, here=here, gauss=gauss, nodal=nodal, threads=threads
            )
        return _quality(shapes, monitor, rule, survey, errors, nodal)


def measure_errors(
    mesh: AnyMesh,
    u: Field,
    *,
    uniform: Mesh | None = None,
    domain: Domain = UNIT_SQUARE,
    gauss: int | None = None,
    kind: Literal["quad", "triangle"] = "quad",
    degree: int = 1,
    nodal: Array | None = None,
    threads: int = 1,
    alone: bool = False,
) -> InterpolationErrors:
    """The errors alone that :func:`measure_all` measures, for which no metric is evaluated.

    ``alone`` they are compared with those on no other mesh: their gains are NaN.
    """
    with np.errstate(all="ignore"):
        cells = cells_of(mesh, closed_of(domain))
        there, numbers = None if alone else domain, sample(cells.rows) if gauss is None else None
        return _errors(cells, u, uniform, there, (kind, degree), numbers, gauss=gauss, nodal=nodal, threads=threads)


def _errors(
    cells: MeshCells,
    u: Field,
    uniform: Mesh | None,
    domain: Domain | None,
    element: tuple[Literal["quad", "triangle"], int],
    numbers: IntArray | None,
    *,
    here: Norms | None = None,
    gauss: int | None = None,
    nodal: Array | None = None,
    threads: int = 1,
) -> InterpolationErrors:
    """The errors next to those on the uniform or given mesh; ``here`` are the norms of bilinear ones if known.

    They are those in the cells with these ``numbers``, or in all.
    """
    there, rule = _uniform_cells(cells, uniform, domain, element, numbers), error_rule(cells, gauss)
    kind, degree = element
    if element != ("quad", 1):
        return degree_errors(cells, there, u, degree, kind)
    if here is None:
        here = norms(cells, u, rule, numbers, nodal=nodal, threads=threads)
    if there is None or _are_same(cells, there):
        return compared(cells, here, UNKNOWN if there is None else here)
    known = kept_of_uniform(u, there, rule.inner.s.size + rule.edge.s.size)
    if not known:
        known.append(norms(there, u, rule, numbers, threads=threads))
    return compared(cells, here, known[0])


def _are_same(cells: MeshCells, there: Cells) -> bool:
    """Whether all nodes of a mesh are where the lines of the other one cross: both have the same errors then."""
    if there.lines is None:
        return False
    rows, (at_x, at_y) = cells.rows, there.lines
    x, y = MeshRows.of(cells.mesh).nodes(rows.first, rows.last)
    middle = at_x.size // 2
    is_same = x[middle, 1] == at_x[middle] and bool((x == at_x[:, None]).all() and (y == at_y).all())
    return rows.agreed(float(not is_same))[0] == 0.0


def window_image(window: MeshRows, domain: Domain) -> MeshRows:
    """The rows of the uniform mesh of ``domain`` with the numbers of the rows of ``window``."""
    uniform = MeshRows.uniform(window.rows)
    mapped = map_mesh(Mesh(uniform.x, uniform.y), domain)
    return MeshRows(mapped.x, mapped.y, window.rows)


def _uniform_cells(
    cells: MeshCells,
    uniform: Mesh | None,
    domain: Domain | None,
    element: tuple[Literal["quad", "triangle"], int],
    numbers: IntArray | None,
) -> Cells | None:
    """The cells of the mesh that a mesh is compared with, where those with ``numbers`` or all are looked at.

    ``None`` without a ``domain``, and where a mesh of blocks is compared with nothing.
    """
    if uniform is not None:
        found = cells_of(uniform)
        require_same_cells(cells, found)
        return found
    if domain is None or not cells.mesh.is_grid:
        return None
    window = MeshRows.of(cells.mesh)
    if numbers is None and (element != ("quad", 1) or not isinstance(domain, Rectangle)):
        return BilinearCells(window_image(window, domain))
    return UniformCells(window.grid, domain, cells.rows)


def _quality(
    shapes: Shapes,
    monitor: Monitor,
    rule: CellPoints,
    survey: Survey,
    errors: InterpolationErrors | None,
    nodal: Array | None,
) -> Quality:
    cells = shapes.cells

    def compute(row: int) -> Array:
        if row > 1:
            values = shapes.kept[row - 2]
        else:
            values = survey.q_eq if row == 0 else _alignments(cells, monitor, rule, survey)
        return np.asarray(values.reshape(cells.own_shape))

    found = [
        Measure(max=of.max, min=of.min, mean=of.mean, rms=of.rms, compute=partial(compute, row))
        for row, of in enumerate((*survey.statistics, *shapes.statistics))
    ]
    by_name: dict[str, Any] = dict(zip(PER_CELL, found, strict=True))
    return Quality(
        **by_name,
        min_jacobian=float(np.float64(cells.lowest) * cells.count / abs(cells.total_area)),
        min_jacobian_over_mean=float(np.float64(cells.lowest) / (cells.total_area / cells.count)),
        interpolation_error=errors,
        u=nodal,
    )


def _alignments(cells: MeshCells, monitor: Monitor, rule: CellPoints, survey: Survey) -> Array:
    with np.errstate(all="ignore"):
        kept = survey.kept if survey.kept is not None else Survey.of(cells, monitor, rule, keep=True).kept
    assert kept is not None
    return np.asarray(kept[1])


def equidistribution(mesh: AnyMesh, monitor: Monitor, *, gauss: int | None = None, threads: int = 1) -> Array:
    """``Q_eq`` of every cell: its share of the metric's total area, in units of the mean share.

    ``Q_eq(K) = N |K| sqrt(det M_K) / sum over K of |K| sqrt(det M_K)``, N the number of cells, M_K the mean
    over the bilinear quadrilateral K of the monitor's exact metric (Huang and Russell, chapter 4; Haynes and
    Howse, Table 1, prints the maximum). Positive, of mean 1; all are 1 exactly when M is equidistributed.
    Folded cells are infinite and left out of the sum. ``gauss`` and ``threads`` as in :func:`measure`. With some rows
    of a mesh the values are those of the own cells.
    """
    with np.errstate(all="ignore"):
        cells = cells_of(mesh)
        rule = metric_rule(cells, gauss)
        found = Survey.of(cells, monitor, rule, threads=threads).q_eq
        return np.reshape(found, cells.own_shape)


def alignment(mesh: Mesh, monitor: Monitor, *, gauss: int | None = None) -> Array:
    """``Q_ali`` of every cell: how far its shape is from a square in the metric M_K.

    ``Q_ali = tr(F'^T M_K F') / (2 sqrt(det M_K) det F')`` (Huang and Russell, chapter 4), F' the Jacobian
    matrix of the bilinear map of the unit square onto the cell. F' varies over the cell: the value is the
    largest, which is that of a corner. At least 1.
    """
    with np.errstate(all="ignore"):
        cells = cells_of(mesh)
        rule = metric_rule(cells, gauss)
        found = _alignments(cells, monitor, rule, Survey.of(cells, monitor, rule, keep=True))
        return found.reshape(cells.own_shape)


def shape_regularity(mesh: Mesh) -> Array:
    """``Q_geo`` of every cell: :func:`alignment` with the identity for the metric.

    At least 1, and 1 for a square; ``(r + 1/r) / 2`` for a rectangle of sides in the ratio r.
    """
    cells = cells_of(mesh)
    return np.reshape(Shapes.of(cells, keep=True).kept[SHAPES.index("q_geo")], cells.own_shape)


def gauss_points(cells: MeshCells, gauss: int | None = None) -> int:
    """The Gauss points per direction and cell for a mesh of this size, unless ``gauss`` gives them."""
    return gauss or next((points for most, points in GAUSS_POINTS if cells.count <= most), GAUSS_POINTS_BEYOND)


def metric_rule(cells: MeshCells, gauss: int | None = None) -> CellPoints:
    """The quadrature of the mean metric of a cell: Gauss points, on many cells their corners; ``gauss`` as there."""
    if gauss is None and cells.count > MAX_GAUSS_CELLS:
        return CellPoints.corners()
    return CellPoints.gauss(gauss_points(cells, gauss))


def error_rule(cells: MeshCells, gauss: int | None = None) -> ErrorRule:
    """The quadrature of interpolation errors on a mesh of this size, with ``gauss`` points if they are given."""
    points = gauss_points(cells, gauss)
    is_lean = gauss is None and points == GAUSS_POINTS_BEYOND
    return ErrorRule.lean() if is_lean else ErrorRule.gauss(points)


# How much of a domain the cells of a mesh cut off at its curved sides.

ROUNDING = 1e-6
"""The tolerance of the bound, as a share of it: parameters of a finished mesh are found only to rounding."""


@dataclass(frozen=True, kw_only=True)
class CutOff:
    """Areas between the curved sides of a domain and the cells, as shares of the area of the domain.

    What cells leave out, and what they cover beyond the domain, both count.
    """

    share: float
    """The share that the mesh cuts off."""
    initial: float
    """The share that the uniform or the initial mesh cuts off."""

    @property
    def most(self) -> float:
        """The largest share of a mesh of least error: ``initial`` plus 0.25, or twice ``initial`` if that is more."""
        return most_cut_off(self.initial, 1.0)

    @property
    def is_much(self) -> bool:
        """Whether the mesh has more than :attr:`most`, and is refused where the error is to be small."""
        return self.share > self.most * (1.0 + ROUNDING)


def measure_cut_off(domain: Domain | Blocks, reference: AnyMesh) -> CutOff:
    """The cut-off of a mesh by its nodes on the reference square; of blocks, ``reference`` is the mesh itself."""
    if isinstance(domain, Rectangle):
        return CutOff(share=0.0, initial=0.0)
    if isinstance(domain, Blocks):
        return _between_curves(domain, reference)
    window = MeshRows.of(reference)
    rows = window.rows
    here = [_of_window(domain, one) if rows.first < rows.last else 0.0 for one in (window, MeshRows.uniform(rows))]
    share, initial = rows.summed(np.array(here)) / domain.area
    return CutOff(share=float(share), initial=float(initial))


def _of_window(domain: Domain, reference: MeshRows) -> float:
    """The area that the own rows cut off; a seam is no side."""
    rows, (closed_xi, closed_eta) = reference.rows, closed_of(domain)
    nodes, lines = np.stack(reference.nodes(rows.first, rows.last)), list[Array]()
    if not closed_eta:
        lines += [nodes[:, :, 0], nodes[:, :, -1]]
    if not closed_xi:
        lines += [nodes[:, 0]] * (rows.first == 0) + [nodes[:, -1]] * (rows.last == rows.cells[0])
    return sum(cut_off(domain, line[:, :-1], line[:, 1:]) for line in lines)


def _between_curves(domain: Blocks, mesh: AnyMesh) -> CutOff:
    """The cut-off of a mesh of a domain in blocks; its nodes are at the nearest points of their curves."""
    edges = np.concatenate([side for side in domain.mesh.sides.values() if len(side)])
    total = np.zeros(2)
    for number, curve in enumerate(domain.curves):
        slides, first = domain.node_curve == number, domain.node_parameter
        chords = Chords.of(curve, edges, slides, domain.mesh.points.T, first)
        if chords is None:
            continue
        here = first.copy()
        here[slides] = curve.nearest(mesh.x[slides], mesh.y[slides])
        if curve.closed:
            span = curve.ends[1] - curve.ends[0]
            here[slides] -= span * np.round((here - first)[slides] / span)
        total += chords.pieces(here).area, chords.pieces(first).area
    share, initial = total / domain.area
    return CutOff(share=float(share), initial=float(initial))
