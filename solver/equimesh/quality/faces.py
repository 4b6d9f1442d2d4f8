"""The faces of a mesh as codes with cell-centred unknowns see them: non-orthogonality and skewness.

Both are defined as in OpenFOAM 1912, ``primitiveMeshTools`` and ``checkMesh``, for a mesh that is one cell thick.
The centre of a cell is the centroid of its area, the centre of a face the middle of its edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from equimesh.fields.expression import Field
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import OPEN, Closed, tied_nodes
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import AnyMesh, QuadCells, cells_of
from equimesh.quality.shapes import INNER_DISTANCE_SHARE, SIDE_DISTANCE_SHARE, Shapes


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


def measure_faces(mesh: AnyMesh, closed: Closed = OPEN, *, shapes: Shapes | None = None) -> Faces:
    """The measures of the faces of ``mesh``; of the whole one. They follow from its ``shapes`` where these are known.

    Interfaces between blocks are faces as all others, and so are the sides of a periodic join, which are one. So are
    the seams of a grid with ``closed`` lines, whose rows are all here.
    """
    if isinstance(mesh, Mesh) and any(closed):
        return _of_any(Mesh(mesh.x, mesh.y, ties=tied_nodes((mesh.x.shape[0], mesh.x.shape[1]), closed)))
    if isinstance(mesh, Mesh) and not mesh.is_grid:
        return _of_any(mesh)
    found = (Shapes.of(cells_of(mesh)) if shapes is None else shapes).faces
    return FOLDED if found is None else _faces(*found)


def _of_any(mesh: Mesh) -> Faces:
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
    columns, smallest = at_x.shape[1], np.inf
    lowest = np.empty(columns)
    for i in range(at_x.shape[0]):
        x0, x1, y0, y1, to_x, to_y = x[i], x[i + 1], y[i], y[i + 1], at_x[i], at_y[i]
        for j in range(columns):
            ax, ay = x1[j] - x0[j], y1[j] - y0[j]  # the other corners, seen from the first one
            bx, by = x1[j + 1] - x0[j], y1[j + 1] - y0[j]
            cx, cy = x0[j + 1] - x0[j], y0[j + 1] - y0[j]
            one, two = ax * by - ay * bx, bx * cy - by * cx
            at_b, at_d = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax), ax * cy - ay * cx
            here = min(min(one, two), min(at_b, at_d))
            check = one + two + at_b + at_d
            lowest[j] = here if check - check == 0.0 else -1.0
            weight = 1.0 / (3.0 * (one + two))
            to_x[j] = x0[j] + weight * (one * (ax + bx) + two * (bx + cx))
            to_y[j] = y0[j] + weight * (one * (ay + by) + two * (by + cy))
        for j in range(columns):
            smallest = min(smallest, lowest[j])
    return smallest > 0.0


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
    """The :class:`~equimesh.quality.shapes.FaceSums` of edges between any cells, which
    :class:`~equimesh.meshes.cell_edges.CellEdges` has.

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


# The error of a code with cell-centred unknowns: a Poisson problem with the solution u, solved on the mesh itself.
#
# The scheme is that of OpenFOAM's ``Gauss linear corrected``, after its correction has converged. The flux through a
# face is the difference of the values next to it along the normal, plus the rest of the gradient that is interpolated
# from the two cells: H. Jasak, *Error analysis and estimation for the finite volume method* (Imperial College, 1996),
# section 3.3.1, the over-relaxed correction. Gradients of cells are sums over faces. On the sides u is given.

MIN_NORMAL_SHARE = 0.05
"""The smallest share of the distance of two centres that counts as their distance along the normal."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Faces:
    """Some faces: their area vectors, which leave the cell ``owner``, and their middles, both of shape ``(2, n)``."""

    area: Array
    middle: Array
    owner: IntArray

    @classmethod
    def between(cls, start: Array, end: Array, owner: IntArray) -> _Faces:
        """The faces from ``start`` to ``end``, arrays ``(2, ...)``; the owner lies to the left."""
        edge, middle = end - start, 0.5 * (start + end)
        return cls(area=np.stack([edge[1], -edge[0]]).reshape(2, -1), middle=middle.reshape(2, -1), owner=owner.ravel())

    @classmethod
    def joined(cls, *parts: _Faces) -> _Faces:
        """The faces of all ``parts``."""
        return cls(
            area=np.concatenate([part.area for part in parts], axis=1),
            middle=np.concatenate([part.middle for part in parts], axis=1),
            owner=np.concatenate([part.owner for part in parts]),
        )


def poisson_error(mesh: Mesh, u: Field) -> float:
    """The L2 norm of the error at the cell centres, over the root of the area; infinite where there is no solution.

    That is the case on a folded mesh, and where u or its second derivatives are not finite.
    """
    points, centres = points_and_centres(mesh)
    if centres is None:
        return math.inf
    volume = _volumes(points)
    u_c, _, _, u_xx, _, u_yy = u.evaluate(np.ascontiguousarray(centres[0]), np.ascontiguousarray(centres[1]), order=2)
    sides = _sides(points)
    (u_sides,) = u.evaluate(*sides.middle)
    source = (u_xx + u_yy).ravel() * volume
    if not (np.isfinite(source).all() and np.isfinite(u_sides).all() and np.isfinite(u_c).all()):
        return math.inf
    matrix, right = _system(points, centres.reshape(2, -1), volume, sides, u_sides)
    try:
        found = scipy.sparse.linalg.splu(matrix.tocsc()).solve(source - right)
    except RuntimeError:  # a singular matrix
        return math.inf
    error = math.sqrt(float(volume @ (found - u_c.ravel()) ** 2) / float(volume.sum()))
    return error if math.isfinite(error) else math.inf


def _volumes(points: Array) -> Array:
    first, second = points[:, 1:, 1:] - points[:, :-1, :-1], points[:, :-1, 1:] - points[:, 1:, :-1]
    areas: Array = 0.5 * (first[0] * second[1] - first[1] * second[0])
    return areas.ravel()


def _numbers(points: Array) -> IntArray:
    shape = points.shape[1] - 1, points.shape[2] - 1
    return np.arange(shape[0] * shape[1]).reshape(shape)


def _sides(points: Array) -> _Faces:
    number = _numbers(points)
    return _Faces.joined(
        _Faces.between(points[:, 0, 1:], points[:, 0, :-1], number[0]),
        _Faces.between(points[:, -1, :-1], points[:, -1, 1:], number[-1]),
        _Faces.between(points[:, :-1, 0], points[:, 1:, 0], number[:, 0]),
        _Faces.between(points[:, 1:, -1], points[:, :-1, -1], number[:, -1]),
    )


def _system(
    points: Array, centres: Array, volume: Array, sides: _Faces, u_sides: Array
) -> tuple[scipy.sparse.csr_matrix, Array]:
    """The matrix of the sums of fluxes out of the cells, and the part of them that the sides give."""
    number = _numbers(points)
    faces = _Faces.joined(
        _Faces.between(points[:, 1:-1, :-1], points[:, 1:-1, 1:], number[:-1]),
        _Faces.between(points[:, 1:, 1:-1], points[:, :-1, 1:-1], number[:, :-1]),
    )
    beyond = np.concatenate([number[1:].ravel(), number[:, 1:].ravel()])
    cells, count = volume.size, beyond.size
    every = np.arange(count)
    size = np.hypot(*faces.area)
    normal, way = faces.area / size, centres[:, beyond] - centres[:, faces.owner]
    per_length = 1.0 / np.maximum((normal * way).sum(axis=0), MIN_NORMAL_SHARE * np.hypot(*way))
    out = _matrix((np.ones(count), -np.ones(count)), (faces.owner, beyond), (every, every), (cells, count))
    before = np.abs((faces.area * (faces.middle - centres[:, faces.owner])).sum(axis=0))
    after = np.abs((faces.area * (centres[:, beyond] - faces.middle)).sum(axis=0))
    share = after / (before + after)
    mean = _matrix((share, 1.0 - share), (every, every), (faces.owner, beyond), (count, cells))
    matrix = -out @ scipy.sparse.diags(size * per_length) @ out.T
    at_side = np.hypot(*sides.area)
    depth = (sides.area * (sides.middle - centres[:, sides.owner])).sum(axis=0) / at_side
    matrix -= scipy.sparse.diags(np.bincount(sides.owner, at_side / depth, cells))
    right: Array = np.bincount(sides.owner, at_side / depth * u_sides, cells).astype(float)
    rest = normal - way * per_length
    for axis in (0, 1):
        correct = out @ scipy.sparse.diags(size * rest[axis]) @ mean @ scipy.sparse.diags(1.0 / volume)
        matrix += correct @ out @ scipy.sparse.diags(faces.area[axis]) @ mean
        right += correct @ np.bincount(sides.owner, sides.area[axis] * u_sides, cells)
    return matrix, right


def _matrix(
    values: tuple[Array, Array],
    rows: tuple[IntArray, IntArray],
    columns: tuple[IntArray, IntArray],
    shape: tuple[int, int],
) -> scipy.sparse.csr_matrix:
    return scipy.sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    )


# The checks of cells and faces that OpenFOAM's ``checkMesh -allGeometry`` makes, besides angles and skewness.
#
# As in ``primitiveMeshTools`` of OpenFOAM 1912, for a mesh that is one cell thick.

MIN_DETERMINANT = 0.001
"""The smallest determinant of a cell that passes."""
MIN_WEIGHT = 0.05
"""The smallest weight of a face that passes."""
MIN_VOLUME_RATIO = 0.01
"""The smallest ratio of the volumes of two neighbours that passes."""
MAX_SKEWNESS = 4.0
"""The largest skewness of a face that passes."""


@dataclass(frozen=True, kw_only=True)
class Checks:
    """The number that is checked; NaN for a folded mesh."""

    determinant: float
    """The smallest determinant of a cell: of the sum of its inner faces' area vectors times themselves, over 8.

    They are divided by their mean length. It is 0.5 for a square inside a mesh, and about 8 over the squared ratio of
    the sides for a long rectangle there.
    """
    weight: float
    """The smallest share of the distance of two centres, along the normal, that lies on one side of their face."""
    volume_ratio: float
    """The smallest ratio of the areas of two neighbours."""
    skewness: float
    """As :attr:`~equimesh.quality.faces.Faces.skewness`."""

    @property
    def passed(self) -> bool:
        """Whether all checks pass."""
        return (
            self.determinant >= MIN_DETERMINANT
            and self.weight >= MIN_WEIGHT
            and self.volume_ratio >= MIN_VOLUME_RATIO
            and self.skewness <= MAX_SKEWNESS
        )


def check_cells(mesh: Mesh) -> Checks:
    """The checks of ``mesh``."""
    points, centres = points_and_centres(mesh)
    if centres is None:
        return Checks(determinant=np.nan, weight=np.nan, volume_ratio=np.nan, skewness=np.nan)
    first, second = points[:, 1:, 1:] - points[:, :-1, :-1], points[:, :-1, 1:] - points[:, 1:, :-1]
    volume = first[0] * second[1] - first[1] * second[0]
    # The edges between neighbours along xi, and between those along eta, turned by a right angle.
    edges = np.diff(points, axis=2)[:, 1:-1], np.diff(points, axis=1)[:, :, 1:-1]
    middles = 0.5 * (points[:, 1:-1, 1:] + points[:, 1:-1, :-1]), 0.5 * (points[:, 1:, 1:-1] + points[:, :-1, 1:-1])
    weight, ratio = 0.5, 1.0
    for axis, (edge, middle) in enumerate(zip(edges, middles, strict=True)):
        before, after = (np.take(centres, range(*span), axis=1 + axis) for span in _spans(centres.shape[1 + axis]))
        below, above = np.abs(_cross(edge, middle - before)), np.abs(_cross(edge, after - middle))
        small, large = (np.take(volume, range(*span), axis=axis) for span in _spans(volume.shape[axis]))
        if edge.size:
            weight = min(weight, float((np.minimum(below, above) / (below + above)).min()))
            ratio = min(ratio, float((np.minimum(small, large) / np.maximum(small, large)).min()))
    return Checks(
        determinant=_determinant(edges, volume.shape),
        weight=weight,
        volume_ratio=ratio,
        skewness=measure_faces(mesh).skewness,
    )


def _determinant(edges: tuple[Array, Array], shape: tuple[int, ...]) -> float:
    """The smallest determinant of a cell; 0 for a cell without an inner face."""
    sums, lengths, counts = np.zeros((3, *shape)), np.zeros(shape), np.zeros(shape)
    for axis, edge in enumerate(edges):
        x, y = edge
        entries, length = np.stack([y * y, -x * y, x * x]), np.hypot(x, y)
        for first, last in _spans(shape[axis]):
            part = (slice(first, last), slice(None)) if axis == 0 else (slice(None), slice(first, last))
            sums[(slice(None), *part)] += entries
            lengths[part] += length
            counts[part] += 1.0
    mean = lengths / np.maximum(counts, 1.0)
    with np.errstate(all="ignore"):
        found = (sums[0] * sums[2] - sums[1] ** 2) / mean**4 / 8.0
    return float(np.where(counts > 0.0, found, 0.0).min())


def _spans(count: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """All cells of a row but the last, and all but the first."""
    return (0, count - 1), (1, count)


def _cross(one: Array, other: Array) -> Array:
    product: Array = one[0] * other[1] - one[1] * other[0]
    return product
