"""The error of a code with cell-centred unknowns: a Poisson problem with the solution u, solved on the mesh itself.

The scheme is that of OpenFOAM's ``Gauss linear corrected``, after its correction has converged. The flux through a face
is the difference of the values next to it along the normal, plus the rest of the gradient that is interpolated from
the two cells: H. Jasak, *Error analysis and estimation for the finite volume method* (Imperial College, 1996), section
3.3.1, the over-relaxed correction. Gradients of cells are sums over faces. On the sides u is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.faces import points_and_centres

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
        found = splu(matrix.tocsc()).solve(source - right)
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


def _system(points: Array, centres: Array, volume: Array, sides: _Faces, u_sides: Array) -> tuple[sp.csr_matrix, Array]:
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
    matrix = -out @ sp.diags(size * per_length) @ out.T
    at_side = np.hypot(*sides.area)
    depth = (sides.area * (sides.middle - centres[:, sides.owner])).sum(axis=0) / at_side
    matrix -= sp.diags(np.bincount(sides.owner, at_side / depth, cells))
    right: Array = np.bincount(sides.owner, at_side / depth * u_sides, cells).astype(float)
    rest = normal - way * per_length
    for axis in (0, 1):
        correct = out @ sp.diags(size * rest[axis]) @ mean @ sp.diags(1.0 / volume)
        matrix += correct @ out @ sp.diags(faces.area[axis]) @ mean
        right += correct @ np.bincount(sides.owner, sides.area[axis] * u_sides, cells)
    return matrix, right


def _matrix(
    values: tuple[Array, Array],
    rows: tuple[IntArray, IntArray],
    columns: tuple[IntArray, IntArray],
    shape: tuple[int, int],
) -> sp.csr_matrix:
    return sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
