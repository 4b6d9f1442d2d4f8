"""Gradients at the nodes of a mesh from cubics that are fitted to the values at the nodes around."""

from __future__ import annotations

import numpy as np
import scipy

from equimesh.numerics.types import Array, IntArray, Pair

POWERS = tuple((i, k - i) for k in (1, 2, 3) for i in range(k, -1, -1))
"""The monomials of a cubic without its constant, which is the value at the node; the first two are linear."""
RIDGE = 1e-15
"""The share of the mean of the diagonal that is added to it: patches of few layers do not determine all monomials."""
MAX_NODES = 4096
"""Nodes whose cubics are fitted at once."""


def patch_gradients(points: Array, cells: IntArray, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes ``points``, shape ``(n, 2)``, of quadrilaterals ``(m, 4)``, from ``values`` ``(n,)``.

    The cubic through the value at a node fits the values at the nodes of two layers of cells around it best, of three
    at and next to the boundary, by squares over squared distances, which are measured by the shape of the patch. Cubics
    are exact on every mesh, so that gradients are accurate to O(h^3).

    Source: Z. Zhang and A. Naga, *A new finite element gradient recovery method: superconvergence property*, SIAM J.
    Sci. Comput. 26 (2005): polynomials of degree p + 1 for elements of degree p.
    """
    starts, patches = _patches(points, cells)
    sizes, gradients = np.diff(starts), np.empty((len(points), 2))
    for first in range(0, len(points), MAX_NODES):
        some = np.arange(first, min(first + MAX_NODES, len(points)))
        places = np.arange(int(sizes[some].max()))
        is_there = places < sizes[some, None]
        around = patches[np.minimum(starts[some, None] + places, len(patches) - 1)]
        around = np.where(is_there, around, some[:, None])
        gradients[some] = _fitted(points[around] - points[some, None], values[around] - values[some, None])
    return gradients[:, 0], gradients[:, 1]


def _patches(points: Array, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Where the patch of each node begins, shape ``(n + 1,)``, and the nodes of all patches."""
    corners = np.repeat(np.arange(len(cells)), 4), cells.ravel()
    of_cells = scipy.sparse.csr_array((np.ones(cells.size), corners), shape=(len(cells), len(points)))
    near = of_cells.T @ of_cells
    near.data[:] = 1.0
    two = near @ near
    ends = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, place, count = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True, return_counts=True)
    at_boundary = np.zeros(len(points))
    at_boundary[ends[count[place] == 1]] = 1.0
    wide = np.asarray(near @ at_boundary > 0.0)
    rows = scipy.sparse.diags_array(wide.astype(float)).tocsr()
    rest = scipy.sparse.diags_array((~wide).astype(float)).tocsr()
    every = (rest @ two + (rows @ two) @ near).tocsr()
    every.eliminate_zeros()
    return every.indptr.astype(np.int64), every.indices.astype(np.int64)


def _fitted(offsets: Array, rises: Array) -> Array:
    """The gradients of cubics, shape ``(n, 2)``, from the places and values of patches, relative to those of the node.

    ``offsets`` have the shape ``(n, k, 2)``, ``rises`` ``(n, k)``; entries without an offset do not count.
    """
    spread = np.einsum("nki,nkj->nij", offsets, offsets)
    factor = np.linalg.cholesky(spread / max(1, offsets.shape[1]))
    local = np.linalg.solve(factor, offsets.swapaxes(1, 2))
    squares = (local**2).sum(axis=1)
    weights = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)
    monomials = np.stack([local[:, 0] ** i * local[:, 1] ** j for i, j in POWERS], axis=1)
    weighted = monomials * weights[:, None]
    normal = weighted @ monomials.swapaxes(1, 2)
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2) / len(POWERS)
    normal += ridge[:, None, None] * np.eye(len(POWERS))
    slopes = np.linalg.solve(normal, weighted @ rises[..., None])[:, :2]
    return np.asarray(np.linalg.solve(factor.swapaxes(1, 2), slopes)[..., 0])
