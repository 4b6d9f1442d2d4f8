"""The faces of a mesh as codes with cell-centred unknowns see them: non-orthogonality and skewness.

Both are defined as in OpenFOAM 1912, ``primitiveMeshTools`` and ``checkMesh``, for a mesh that is one cell thick.
The centre of a cell is the centroid of its area, the centre of a face the middle of its edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from equimesh.inputs import finite_or_none
from equimesh.meshes.closed import OPEN, Closed
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_window import MeshWindow
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.gather import joined
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.quad_cells import AnyMesh, QuadCells

INNER_DISTANCE_SHARE = 0.2
"""The share of the distance between two centres that is at least the length of reference for skewness."""
SIDE_DISTANCE_SHARE = 0.4
"""The same of the distance between the centre of a cell and a side of the domain."""


@dataclass(frozen=True, kw_only=True)
class Faces:
    """Measures of all faces of a mesh; NaN for a mesh with a folded cell."""

    non_orthogonality: float
    """The largest angle between the normal of an inner face and the line of its two cell centres, in degrees."""
    mean_non_orthogonality: float
    """The angle whose cosine is the mean of their cosines: the average that ``checkMesh`` prints, in degrees."""
    skewness: float
    """The largest skewness of a face, those of the sides included; dimensionless.

    It is the distance between the middle of the face and the point where the line of the two centres meets the face.
    It is divided by half the length of the face, or by ``INNER_DISTANCE_SHARE`` of the distance of the centres if that
    is longer. On a side the foot of the perpendicular from the centre takes the place of that point.
    """

    def summary(self) -> dict[str, float | None]:
        """The two angles as plain Python data, ready for JSON."""
        return {
            "max": finite_or_none(self.non_orthogonality),
            "mean": finite_or_none(self.mean_non_orthogonality),
        }


FOLDED = Faces(non_orthogonality=math.nan, mean_non_orthogonality=math.nan, skewness=math.nan)
"""The measures of a mesh with a folded cell."""


def measure_faces(mesh: AnyMesh, closed: Closed = OPEN) -> Faces:
    """The measures of the faces of ``mesh``; of the whole one also where a process holds some of its rows.

    Interfaces between blocks are faces as all others, and so are the sides of a periodic join, which are one. So are
    the seams of a grid with ``closed`` lines, which one process holds.
    """
    if isinstance(mesh, QuadMesh):
        return _of_blocks(mesh)
    window = MeshWindow.of(mesh)
    if any(closed):
        return _of_closed(window, closed)
    strips = np.array([_strip(window, first, last) for first, last in window.rows.strips]).reshape(-1, 5)
    found = joined(window.rows.channel, strips)
    if not found[:, 4].all():
        return FOLDED
    return _faces(found[:, 0].min(), found[:, 1].sum(), found[:, 2].sum(), found[:, 3].max())


def _of_closed(window: MeshWindow, closed: Closed) -> Faces:
    """The faces of a grid before which the last cells of its closed lines stand once more."""
    x, y = (_with_last_cells(q, closed) for q in (window.x, window.y))
    centres = np.empty((2, x.shape[0] - 1, x.shape[1] - 1))
    if not place_centres(x, y, *centres):
        return FOLDED
    first, last = (int(closed[0]), int(closed[1])), (not closed[0], not closed[1])
    return _faces(*survey_faces(x, y, centres, first[0], last[0], first[1], last[1]))


def _with_last_cells(nodes: Array, closed: Closed) -> Array:
    """One coordinate of the nodes, with the nodes before the seams, which lie a period before their originals."""
    if closed[0]:
        nodes = np.concatenate([nodes[-2:-1] - (nodes[-1:] - nodes[:1]), nodes])
    if closed[1]:
        nodes = np.concatenate([nodes[:, -2:-1] - (nodes[:, -1:] - nodes[:, :1]), nodes], axis=1)
    return np.ascontiguousarray(nodes)


def _of_blocks(mesh: QuadMesh) -> Faces:
    cells, centres = QuadCells(mesh), np.empty((2, len(mesh.cells)))
    corners = cells.corners(cells.own)
    if not place_centroids(corners, *centres):
        return FOLDED
    return _faces(*survey_edges(corners, centres, cells.edges.cells, cells.edges.places))


def _faces(lowest: float, total: float, count: float, skewness: float) -> Faces:
    """From the smallest cosine, the sum of all and their number, and the largest skewness."""
    return Faces(
        non_orthogonality=_degrees(float(lowest)),
        mean_non_orthogonality=_degrees(float(total / count) if count else 1.0),
        skewness=float(skewness),
    )


def _strip(window: MeshWindow, first: int, last: int) -> tuple[float, ...]:
    """What the faces contribute that begin in the rows ``first`` to ``last - 1`` of cells, and whether these are valid.

    The faces on the last side belong to the last row of cells.
    """
    before = max(first - 1, 0)
    x, y = window.nodes(before, last)
    centres = np.empty((2, x.shape[0] - 1, x.shape[1] - 1))
    valid = place_centres(x, y, *centres)
    return *survey_faces(x, y, centres, first - before, last == window.rows.cells[0], 0, True), float(valid)


def points_and_centres(mesh: Mesh) -> tuple[Array, Array | None]:
    """The nodes, shape ``(2, n_xi, n_eta)``, and the centroids of the cells; ``None`` where a cell is folded."""
    points = np.stack([np.ascontiguousarray(q, dtype=float) for q in (mesh.x, mesh.y)])
    centres = np.empty((2, points.shape[1] - 1, points.shape[2] - 1))
    return points, centres if place_centres(points[0], points[1], centres[0], centres[1]) else None


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, cosine)))


@compiled
def place_centres(x: Array, y: Array, at_x: Array, at_y: Array) -> bool:
    """Write the centroids of all cells; returns whether no cell is folded."""
    valid = True
    for i in range(at_x.shape[0]):
        for j in range(at_x.shape[1]):
            ax, ay = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]  # the other corners, seen from the first one
            bx, by = x[i + 1, j + 1] - x[i, j], y[i + 1, j + 1] - y[i, j]
            cx, cy = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            first, second = ax * by - ay * bx, bx * cy - by * cx
            at_b, at_d = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax), ax * cy - ay * cx
            valid = valid and first > 0.0 and second > 0.0 and at_d > 0.0 and at_b > 0.0
            weight = 1.0 / (3.0 * (first + second))
            at_x[i, j] = x[i, j] + weight * (first * (ax + bx) + second * (bx + cx))
            at_y[i, j] = y[i, j] + weight * (first * (ay + by) + second * (by + cy))
    return valid


@compiled
def survey_faces(
    x: Array, y: Array, centres: Array, first: int, to_side: bool, lowest_column: int, to_top: bool
) -> tuple[float, float, float, float]:
    """The smallest cosine of inner faces, the sum of their cosines and their number, and the largest skewness.

    These are the faces from the ``first`` row of nodes on, and with ``to_side`` also those on the last row. The first
    row is on a side if it is row 0. ``lowest_column`` and ``to_top`` are the same of the columns. ``centres`` of shape
    ``(2, rows of cells, columns)`` are those of the cells.
    """
    at_x, at_y = centres[0], centres[1]
    cells_xi, cells_eta = at_x.shape
    lowest, total, skewness, count = 1.0, 0.0, 0.0, 0.0
    for i in range(first, cells_xi + (1 if to_side else 0)):
        for j in range(lowest_column, cells_eta + (1 if to_top else 0)):
            for along in range(2):  # the edge that leaves the node along xi, then along eta
                end_i, end_j = i + 1 - along, j + along
                if end_i > cells_xi or end_j > cells_eta:
                    continue
                ex, ey = x[end_i, end_j] - x[i, j], y[end_i, end_j] - y[i, j]
                half = 0.5 * np.sqrt(ex * ex + ey * ey)
                last_i, last_j = min(i, cells_xi - 1), min(j, cells_eta - 1)
                before_i, before_j = (last_i, j - 1) if along == 0 else (i - 1, last_j)
                mx, my = x[i, j] + 0.5 * ex, y[i, j] + 0.5 * ey
                if before_i < 0 or before_j < 0 or (j if along == 0 else i) == (cells_eta if along == 0 else cells_xi):
                    own_i, own_j = max(before_i, 0), max(before_j, 0)
                    fx, fy = mx - at_x[own_i, own_j], my - at_y[own_i, own_j]
                    off = abs(fx * ex + fy * ey) / (2.0 * half)
                    apart = abs(fx * ey - fy * ex) / (2.0 * half)
                    skewness = max(skewness, off / max(SIDE_DISTANCE_SHARE * apart, half))
                    continue
                fx, fy = mx - at_x[before_i, before_j], my - at_y[before_i, before_j]
                dx, dy = (
                    at_x[last_i, last_j] - at_x[before_i, before_j],
                    at_y[last_i, last_j] - at_y[before_i, before_j],
                )
                apart, across = np.sqrt(dx * dx + dy * dy), abs(dx * ey - dy * ex)
                cosine = across / (apart * 2.0 * half)
                lowest, total, count = min(lowest, cosine), total + cosine, count + 1.0
                share = abs(fx * ey - fy * ex) / across
                sx, sy = fx - share * dx, fy - share * dy
                off = np.sqrt(sx * sx + sy * sy)
                skewness = max(skewness, off / max(INNER_DISTANCE_SHARE * apart, half))
    return lowest, total, count, skewness


@compiled
def place_centroids(corners: Array, at_x: Array, at_y: Array) -> bool:
    """As :func:`place_centres` for any cells with ``corners`` of shape ``(8, cells)``."""
    valid = True
    for k in range(at_x.size):
        x, y = corners[0, k], corners[4, k]
        ax, ay = corners[1, k] - x, corners[5, k] - y
        bx, by = corners[2, k] - x, corners[6, k] - y
        cx, cy = corners[3, k] - x, corners[7, k] - y
        first, second = ax * by - ay * bx, bx * cy - by * cx
        at_b, at_d = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax), ax * cy - ay * cx
        valid = valid and first > 0.0 and second > 0.0 and at_d > 0.0 and at_b > 0.0
        weight = 1.0 / (3.0 * (first + second))
        at_x[k] = x + weight * (first * (ax + bx) + second * (bx + cx))
        at_y[k] = y + weight * (first * (ay + by) + second * (by + cy))
    return valid


@compiled
def survey_edges(
    corners: Array, centres: Array, cells: IntArray, places: IntArray
) -> tuple[float, float, float, float]:
    """As :func:`survey_faces` for edges between any cells, as :class:`~equimesh.meshes.cell_edges.CellEdges` has them.

    The way between two centres goes through the middle of the face as each cell sees it: across a periodic join the
    two middles lie apart.
    """
    lowest, total, skewness, count = 1.0, 0.0, 0.0, 0.0
    for e in range(len(cells)):
        own, start = cells[e, 0], places[e, 0]
        end = (start + 1) % 4
        x, y = corners[start, own], corners[4 + start, own]
        ex, ey = corners[end, own] - x, corners[4 + end, own] - y
        half = 0.5 * np.sqrt(ex * ex + ey * ey)
        fx, fy = x + 0.5 * ex - centres[0, own], y + 0.5 * ey - centres[1, own]
        other = cells[e, 1]
        if other < 0:
            off = abs(fx * ex + fy * ey) / (2.0 * half)
            apart = abs(fx * ey - fy * ex) / (2.0 * half)
            skewness = max(skewness, off / max(SIDE_DISTANCE_SHARE * apart, half))
            continue
        start = places[e, 1]
        end = (start + 1) % 4
        dx = fx + centres[0, other] - 0.5 * (corners[start, other] + corners[end, other])
        dy = fy + centres[1, other] - 0.5 * (corners[4 + start, other] + corners[4 + end, other])
        apart, across = np.sqrt(dx * dx + dy * dy), abs(dx * ey - dy * ex)
        cosine = across / (apart * 2.0 * half)
        lowest, total, count = min(lowest, cosine), total + cosine, count + 1.0
        share = abs(fx * ey - fy * ex) / across
        sx, sy = fx - share * dx, fy - share * dy
        off = np.sqrt(sx * sx + sy * sy)
        skewness = max(skewness, off / max(INNER_DISTANCE_SHARE * apart, half))
    return lowest, total, count, skewness
