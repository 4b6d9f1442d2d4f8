"""How far the nodes of a mesh move in a step: in cells, and whether all cells stay valid on the way."""

import math
from collections.abc import Iterator

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, IntArray

# The share of nodes that move by at most the reported number of cells: a front occupies more than the rest of them.
NODE_SHARE = 0.95
# A change of u along one edge, as a share of its range, that deserves a sentence where the mesh moves far.
MAX_SILENT_JUMP = 0.5


def displacement(old: Mesh | QuadMesh, new: Mesh | QuadMesh) -> Array:
    """The displacement of every node, shape ``(n_xi, n_eta, 2)`` or ``(n, 2)``, in the unit of the coordinates.

    Divided by the time step it is the velocity of the mesh, for the ALE form of the equations.
    """
    return np.stack([new.x - old.x, new.y - old.y], axis=-1)


def cells_moved(old: Mesh | QuadMesh, new: Mesh | QuadMesh) -> float:
    """The displacement in cells that 95 % of the nodes do not exceed.

    The cells are those of the old mesh: a displacement is the sum of multiples of the half differences of neighbours
    along both lines through the node, and the larger multiple counts. On blocks it is the sum of multiples of the two
    edges of each cell at the node, and the mean over these cells counts.
    """
    if isinstance(old, QuadMesh):
        return float(np.quantile(_moved_in_cells(old, new.points - old.points), NODE_SHARE))
    move = displacement(old, new)
    (x_s, x_t), (y_s, y_t) = ((np.gradient(z, axis=0), np.gradient(z, axis=1)) for z in (old.x, old.y))
    with np.errstate(all="ignore"):  # where a Jacobian of differences vanishes, the node does not count
        det = x_s * y_t - x_t * y_s
        s = (move[..., 0] * y_t - move[..., 1] * x_t) / det
        t = (move[..., 1] * x_s - move[..., 0] * y_s) / det
        cells = np.maximum(np.abs(s), np.abs(t))
    return float(np.quantile(cells[np.isfinite(cells)], NODE_SHARE))


def _moved_in_cells(mesh: QuadMesh, move: Array) -> Array:
    """The displacement of each node in the cells of a mesh of blocks."""
    sums, counts = np.zeros(len(mesh.points)), np.zeros(len(mesh.points))
    for corner in range(4):
        node = mesh.cells[:, corner]
        a, b = (mesh.points[mesh.cells[:, (corner + step) % 4]] - mesh.points[node] for step in (1, 3))
        det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        s = (move[node, 0] * b[:, 1] - move[node, 1] * b[:, 0]) / det
        t = (move[node, 1] * a[:, 0] - move[node, 0] * a[:, 1]) / det
        sums += np.bincount(node, np.maximum(np.abs(s), np.abs(t)), len(sums))
        counts += np.bincount(node, minlength=len(sums))
    return np.asarray((sums / np.maximum(counts, 1.0))[counts > 0.0])


def stays_valid(old: Mesh | QuadMesh, new: Mesh | QuadMesh) -> bool:
    """Whether all cells are valid at all times while each node moves on a straight line at constant speed.

    A corner's Jacobian is then quadratic in time, and positive throughout when it is so at both ends and where it is
    least.
    """
    first, half, last = _jacobians(old, new)
    curvature = 2.0 * (first + last) - 4.0 * half
    slope = last - first - curvature
    with np.errstate(all="ignore"):  # a line has its least value at an end
        at = np.clip(np.nan_to_num(-0.5 * slope / curvature), 0.0, 1.0)
    least = np.minimum(np.minimum(first, last), first + at * (slope + at * curvature))
    return bool(np.all(least > 0.0))


def _jacobians(old: Mesh | QuadMesh, new: Mesh | QuadMesh) -> tuple[Array, Array, Array]:
    """The Jacobians of all corners of the old mesh, of the mesh half way, and of the new one, in one unit."""
    if isinstance(old, Mesh):
        middle = Mesh(0.5 * (old.x + new.x), 0.5 * (old.y + new.y))
        return old.corner_jacobians(), middle.corner_jacobians(), new.corner_jacobians()
    first, half, last = (_corner_areas(p, old) for p in (old.points, 0.5 * (old.points + new.points), new.points))
    return first, half, last


def _corner_areas(points: Array, mesh: QuadMesh) -> Array:
    """The products of the two edges at each corner of the cells of ``mesh``, with its nodes at ``points``."""
    corners = points[mesh.cells]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    return np.asarray(ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0])


def largest_jump(values: Array, cells: IntArray | None = None) -> float:
    """The largest change of nodal values along one edge, as a share of their range; 0 for a constant.

    The values are those of a grid, or with ``cells`` those of a mesh of blocks.
    """
    whole = float(np.ptp(values))
    if cells is not None:
        around = values[cells]
        jump = float(np.abs(np.roll(around, 1, axis=1) - around).max())
        return jump / whole if whole > 0.0 else 0.0
    jumps = (np.abs(np.diff(values, axis=axis)).max() for axis in (0, 1))
    return float(max(jumps)) / whole if whole > 0.0 else 0.0


def outrun_by(moved: float, max_move: float) -> InputError:
    """The refusal of a step in which the mesh would move by ``moved`` cells, more than ``max_move``."""
    return InputError(
        f"the mesh would move by {moved:.2g} cells in this step, more than max_move = {max_move:g}: u has outrun its"
        f" cells. Take {math.ceil(moved / max_move)} smaller time steps; the mesh before is kept",
        field="u",
    )


def about_moves(
    old: Mesh | QuadMesh, new: Mesh | QuadMesh, jump: float, moved: float, max_move: float
) -> Iterator[str]:
    """Sentences about a step in which the mesh ``moved`` by so many cells; ``jump`` is the largest jump of its u."""
    if moved > max_move and jump > MAX_SILENT_JUMP:
        yield (
            f"The mesh moved by {moved:.2g} cells in this step, and u changes by {100 * jump:.0f} % of its range"
            " along one edge of the mesh before: it has outrun its cells there. Take smaller time steps."
        )
    if not stays_valid(old, new):
        yield (
            "A cell would fold while its nodes move on straight lines from the mesh before to this one: take the"
            " carried fields, and not the velocity, in this step."
        )
