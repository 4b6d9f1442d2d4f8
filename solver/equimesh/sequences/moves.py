"""How far the nodes of a mesh move in a step: in cells, and whether all cells stay valid on the way."""

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array

# The share of nodes that move by at most the reported number of cells: a front occupies more than the rest of them.
NODE_SHARE = 0.95


def displacement(old: Mesh, new: Mesh) -> Array:
    """The displacement of every node, shape ``(n_xi, n_eta, 2)``, in the unit of the coordinates.

    Divided by the time step it is the velocity of the mesh, for the ALE form of the equations.
    """
    return np.stack([new.x - old.x, new.y - old.y], axis=-1)


def cells_moved(old: Mesh, new: Mesh) -> float:
    """The displacement in cells that 95 % of the nodes do not exceed.

    The cells are those of the old mesh: a displacement is the sum of multiples of the half differences of neighbours
    along both lines through the node, and the larger multiple counts.
    """
    move = displacement(old, new)
    (x_s, x_t), (y_s, y_t) = ((np.gradient(z, axis=0), np.gradient(z, axis=1)) for z in (old.x, old.y))
    with np.errstate(all="ignore"):  # where a Jacobian of differences vanishes, the node does not count
        det = x_s * y_t - x_t * y_s
        s = (move[..., 0] * y_t - move[..., 1] * x_t) / det
        t = (move[..., 1] * x_s - move[..., 0] * y_s) / det
        cells = np.maximum(np.abs(s), np.abs(t))
    return float(np.quantile(cells[np.isfinite(cells)], NODE_SHARE))


def stays_valid(old: Mesh, new: Mesh) -> bool:
    """Whether all cells are valid at all times while each node moves on a straight line at constant speed.

    A corner's Jacobian is then quadratic in time, and positive throughout when it is so at both ends and where it is
    least.
    """
    middle = Mesh(0.5 * (old.x + new.x), 0.5 * (old.y + new.y))
    first, half, last = (mesh.corner_jacobians() for mesh in (old, middle, new))
    curvature = 2.0 * (first + last) - 4.0 * half
    slope = last - first - curvature
    with np.errstate(all="ignore"):  # a line has its least value at an end
        at = np.clip(np.nan_to_num(-0.5 * slope / curvature), 0.0, 1.0)
    least = np.minimum(np.minimum(first, last), first + at * (slope + at * curvature))
    return bool(np.all(least > 0.0))


def largest_jump(values: Array) -> float:
    """The largest change of nodal values along one edge, as a share of their range; 0 for a constant."""
    whole = float(np.ptp(values))
    jumps = (np.abs(np.diff(values, axis=axis)).max() for axis in (0, 1))
    return float(max(jumps)) / whole if whole > 0.0 else 0.0
