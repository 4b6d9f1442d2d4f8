"""Sparse factorisation of the equations of a grid, in an order that keeps the factors sparse."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from equimesh.numerics.newton import require_finite
from equimesh.numerics.types import Array, IntArray

# Blocks of at most this many nodes are not cut any further.
MAX_BLOCK_NODES = 16
# The smallest pivot on the diagonal, as a share of the largest entry of its column.
MIN_PIVOT_SHARE = 0.01


def factorise(matrix: csc_array, shape: tuple[int, int]) -> Callable[[Array], Array]:
    """A function that solves systems with ``matrix``, whose unknowns are x, then y, of the nodes of a grid.

    The nodes are eliminated by nested dissection: less work than in an order that ignores the grid. Raises
    ``RuntimeError`` for a matrix that is singular or not finite.
    """
    require_finite(matrix)
    order = elimination_order(shape)
    turned = csc_array(matrix[order][:, order])
    factors = splu(turned, permc_spec="NATURAL", diag_pivot_thresh=MIN_PIVOT_SHARE, options={"SymmetricMode": True})

    def solve(right: Array) -> Array:
        solution = np.empty_like(right)
        solution[order] = factors.solve(right[order])
        return solution

    return solve


@lru_cache(maxsize=16)
def elimination_order(shape: tuple[int, int]) -> IntArray:
    """The unknowns of a grid in nested dissection order, the two of a node next to each other."""
    nodes = np.concatenate(_dissect(np.arange(shape[0] * shape[1]).reshape(shape)))
    order = np.column_stack([nodes, nodes + shape[0] * shape[1]]).ravel()
    order.setflags(write=False)
    return order


def _dissect(block: IntArray) -> list[IntArray]:
    """The two halves of a block of nodes, then the line that parts them."""
    if block.size <= MAX_BLOCK_NODES:
        return [block.ravel()]
    if block.shape[0] < block.shape[1]:
        block = block.T
    middle = block.shape[0] // 2
    return [*_dissect(block[:middle]), *_dissect(block[middle + 1 :]), block[middle]]
