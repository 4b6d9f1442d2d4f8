"""The nodes of a block between its four sides, by transfinite interpolation.

W. J. Gordon and C. A. Hall, *Construction of curvilinear coordinate systems and applications to mesh generation*,
Int. J. Numer. Meth. Engng 7 (1973).
"""

from collections.abc import Sequence

import numpy as np

from equimesh.numerics.types import Array


def transfinite(sides: Sequence[Array], shares: Sequence[Array]) -> Array:
    """The nodes of a block, shape ``(n_i, n_j, 2)``.

    ``sides`` are the nodes on left, right, bottom and top with their index rising, shape ``(n, 2)`` each, and
    ``shares`` their places on the side from 0 to 1. A line of the block begins and ends at such shares of opposite
    sides; a node stands where two straight lines between them cross in the unit square, and there the four sides are
    blended.
    """
    left, right, bottom, top = sides
    v_left, v_right, u_bottom, u_top = shares
    u_bottom, u_top, v_left, v_right = u_bottom[:, None], u_top[:, None], v_left[None, :], v_right[None, :]
    du, dv = u_top - u_bottom, v_right - v_left
    u = (u_bottom + v_left * du) / (1.0 - du * dv)
    v = (v_left + u_bottom * dv) / (1.0 - du * dv)
    u, v = u[..., None], v[..., None]
    corners = (1.0 - u) * ((1.0 - v) * bottom[0] + v * top[0]) + u * ((1.0 - v) * bottom[-1] + v * top[-1])
    found = (1.0 - v) * bottom[:, None] + v * top[:, None] + (1.0 - u) * left[None] + u * right[None] - corners
    found[0], found[-1], found[:, 0], found[:, -1] = left, right, bottom, top
    return np.asarray(found)
