"""A mesh of second order: cells of nine nodes, whose edges bend on curved sides, and values at all these nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.cell_edges import originals_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh_coupling.elements import (
    MAX_DEGREE,
    MAX_DEGREES,
    element_numbers,
    element_points,
    element_shape,
    nodes_on_edges,
)
from equimesh_coupling.parts import Cells, cuts_of_triangles
from equimesh_coupling.recovery import unique_edges

MIN_SHARE = 0.2
"""The least Jacobian at a node of a cell with bent edges, over that of the cell with straight ones."""
FIRST_BEND = 1e-12
"""A middle nearer to the chord than this share of its length lies on it."""
LATTICE = np.array([[0, 7, 3], [4, 8, 6], [1, 5, 2]])
"""The nine nodes of a cell in rows along t: corners, middles of edges, and the centre."""
SIX = np.array([[[0, 1, 2, 4, 5, 8], [0, 2, 3, 8, 6, 7]], [[0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 6, 8]]])
"""Those of the two triangles of either cut: corners, and the middles of the edges from each to the next."""
AT_NODES = np.array([0.0, 0.5, 1.0])
"""Where solvers need no positive Jacobian: it is 0 where two sides meet smoothly."""
AT_GAUSS_POINTS = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
"""Where they need one."""


ValueDegree: TypeAlias = Literal[1, 2, 3, 4]
"""The degree of the elements at whose nodes values are known."""


@dataclass(frozen=True, eq=False)
class CurvedEdges:
    """Edges of a mesh on curved sides, shape ``(k, 2)``, and the point of the side in the middle of each, ``(k, 2)``.

    The middle is as far from one end as from the other.
    """

    edges: IntArray
    middles: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrderMesh:
    """The nodes and cells of second order of a mesh of ``n`` nodes, ``k`` edges and ``m`` quadrilaterals.

    - ``points``: the nodes of the mesh, then one on each edge, then one in each cell, shape ``(n + k + m, 2)``.
    - ``cells``: the corners of each cell, the middles of its edges, of which edge j leads from corner j to the next,
      and its centre, shape ``(m, 9)``.
    - ``ends``: the two nodes of each edge, the lower number first, in rising order, shape ``(k, 2)``.
    """

    points: Array
    cells: IntArray
    ends: IntArray

    @classmethod
    def of(cls, points: Array, cells: IntArray, curved: CurvedEdges | None = None) -> SecondOrderMesh:
        """From nodes ``(n, 2)`` and quadrilaterals ``(m, 4)``; without ``curved`` all edges are straight.

        Edges inside are straight as far as possible. Where a cell would fold because its side bends by more than the
        cell is thick, the edge across is bent as the side is, and so on inwards. The centre is that of the blended map,
        which is the bilinear one where all edges are straight.

        Raises :class:`~equimesh.errors.InputError` where a cell folds all the same.
        """
        around = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2)
        keys, of_cells = np.unique(_keys(around.reshape(-1, 2)), return_inverse=True)
        ends = np.column_stack([keys >> 32, keys & 0xFFFFFFFF])
        of_cells = of_cells.reshape(-1, 4)
        bends = np.zeros((len(ends), 2))
        if curved is not None:
            places = np.searchsorted(keys, _keys(curved.edges))
            bends[places] = curved.middles - points[ends[places]].mean(axis=1)
        _bend_inside(points, cells, of_cells, bends)
        _check_valid(points, cells, of_cells, bends)
        middles = points[ends].mean(axis=1) + bends
        centres = points[cells].mean(axis=1) + 0.5 * bends[of_cells].sum(axis=1)
        n, k = len(points), len(ends)
        numbers = np.column_stack([cells, n + of_cells, n + k + np.arange(len(cells))])
        return cls(points=np.concatenate([points, middles, centres]), cells=numbers, ends=ends)

    @property
    def corners(self) -> int:
        """The number of nodes of the mesh of first order."""
        return len(self.points) - len(self.ends) - len(self.cells)

    @property
    def without_centres(self) -> int:
        """The number of nodes that are no centres, which come last."""
        return len(self.points) - len(self.cells)

    def edges(self, ends: IntArray) -> IntArray:
        """Begin, end and middle of edges, shape ``(k, 3)``, from their two nodes, shape ``(k, 2)``."""
        places = np.searchsorted(_keys(self.ends), _keys(ends))
        return np.column_stack([ends, self.corners + places])

    def triangles(self, triangles: IntArray) -> IntArray:
        """Triangles of six nodes, corners first, shape ``(2 m, 6)``, from the cut cells, shape ``(2 m, 3)``.

        The rows ``2 k`` and ``2 k + 1`` are cut from cell k. The middle of the cut is the centre of the cell.
        """
        found: IntArray = six_nodes(self.cells, triangles)
        return found

    def at_nodes(self, values: Array) -> Array:
        """Values at all nodes from those at the corners, shape ``(n,)`` or ``(n, c)``: means in between."""
        corners = self.cells[:, :4]
        return np.concatenate([values, values[self.ends].mean(axis=1), values[corners].mean(axis=1)])


def six_nodes(nine: Any, triangles: IntArray) -> Any:
    """What cells of nine nodes have, ``(m, 9)``, at the six of each triangle they are cut into, shape ``(2 m, 6)``."""
    return np.take_along_axis(nine, SIX[cuts_of_triangles(triangles)].reshape(-1, 12), axis=1).reshape(-1, 6)


def _keys(ends: IntArray) -> IntArray:
    """One number for each edge, the same in both directions, in the order of the lower node."""
    keys: IntArray = ends.min(axis=1).astype(np.int64) << 32 | ends.max(axis=1)
    return keys


def _bend_inside(points: Array, cells: IntArray, of_cells: IntArray, bends: Array) -> None:
    """Bend edges inside as the sides are where cells would fold, in place; sides stay as the domain has them."""
    is_bent: BoolArray = np.asarray(bends.any(axis=1))
    is_inside = np.bincount(of_cells.ravel(), minlength=len(bends)) > 1
    at_side = is_bent.copy()
    touched = np.flatnonzero(is_bent[of_cells].any(axis=1))
    while touched.size:
        folded = touched[smallest_shares(points[cells[touched]], bends[of_cells[touched]], AT_NODES) < MIN_SHARE]
        edges = of_cells[folded]
        across = np.roll(edges, 2, axis=1)
        moves = is_bent[edges] & ~is_bent[across] & is_inside[across]
        if not moves.any():
            break
        bends[across[moves]] = bends[edges[moves]]
        is_bent[across[moves]] = True
        touched = np.flatnonzero((is_bent & ~at_side)[of_cells].any(axis=1) | np.isin(np.arange(len(cells)), folded))


def _check_valid(points: Array, cells: IntArray, of_cells: IntArray, bends: Array) -> None:
    """Refuse cells that fold."""
    is_bent: BoolArray = np.asarray(bends.any(axis=1))
    bent = np.flatnonzero(is_bent[of_cells].any(axis=1))
    shares = smallest_shares(points[cells[bent]], bends[of_cells[bent]], AT_GAUSS_POINTS)
    if shares.size and not shares.min() > 0.0:
        place = points[cells[bent[shares.argmin()]]].mean(axis=0)
        raise InputError(
            f"the cell around ({place[0]:.4g}, {place[1]:.4g}) folds where its side bends: take more cells along this"
            " side, or order 1",
            field="order",
        )


def smallest_shares(corners: Array, bends: Array, at: Array) -> Array:
    """The smallest Jacobian of each cell at the points (s, t) of ``at``, over that with straight edges there.

    ``corners`` are those of the cells, ``bends`` the moves of the middles of their edges, both ``(m, 4, 2)``.
    """
    straight = np.concatenate(
        [corners, 0.5 * (corners + np.roll(corners, -1, axis=1)), corners.mean(axis=1, keepdims=True)], axis=1
    )
    moves = np.concatenate([np.zeros_like(corners), bends, 0.5 * bends.sum(axis=1, keepdims=True)], axis=1)
    shares: Array = (_jacobians(straight + moves, at) / _jacobians(straight, at)).min(axis=(1, 2))
    return shares


def _jacobians(nodes: Array, at: Array) -> Array:
    """The Jacobians of cells of nine nodes, ``(m, 9, 2)``, where s and t are those of ``at``, shape ``(m, 3, 3)``."""
    places = nodes[:, LATTICE]
    values = np.stack([(1 - at) * (1 - 2 * at), 4 * at * (1 - at), at * (2 * at - 1)], axis=1)
    slopes = np.stack([4 * at - 3, 4 - 8 * at, 4 * at - 1], axis=1)
    along_s = np.einsum("ia,jb,mabx->mijx", slopes, values, places)
    along_t = np.einsum("ia,jb,mabx->mijx", values, slopes, places)
    return np.asarray(along_s[..., 0] * along_t[..., 1] - along_s[..., 1] * along_t[..., 0])


# The nodes of elements of degree p as those of a mesh with p times p cells in the place of each one.


def lattice_of(mesh: Mesh, degree: int = 2, cells: Cells = "quad") -> Mesh:
    """The mesh with the nodes of elements of a ``degree``, placed by the bilinear map.

    On triangles of degree 2 the node inside of each cell is the middle of the diagonal along which it is cut.
    Of a grid it is a grid of ``(p (n_xi - 1) + 1, p (n_eta - 1) + 1)`` nodes. Of any other mesh its nodes are those of
    :func:`~equimesh_coupling.elements.element_points` in their order, and it has no blocks.
    """
    points = element_points(mesh, degree, cells)
    if mesh.is_grid:
        x, y = (q.reshape(element_shape(mesh, degree)).copy() for q in points.T)
        return Mesh(x, y)
    count, numbers = len(mesh.points), element_numbers(mesh.cells, len(mesh.points), degree)
    corners = numbers[:, :-1, :-1], numbers[:, 1:, :-1], numbers[:, 1:, 1:], numbers[:, :-1, 1:]

    def parts(edges: IntArray) -> IntArray:
        along = nodes_on_edges(edges, mesh.cells, count, degree)
        return np.stack([along[:, :-1], along[:, 1:]], axis=2).reshape(-1, 2)

    return Mesh(
        points=points,
        cells=np.stack(corners, axis=-1).reshape(-1, 4),
        sides={name: parts(edges) for name, edges in mesh.sides.items()},
        ties=np.concatenate([mesh.ties, _tied_between(mesh, degree)]),
    )


def _tied_between(mesh: Mesh, degree: int) -> IntArray:
    """The nodes of elements on edges that are copies, and those on their originals, shape ``(k, 2)``."""
    count, cells = len(mesh.points), mesh.cells
    ends = np.sort(unique_edges(cells)[0], axis=1)
    wanted = originals_of(count, mesh.ties)[ends]
    is_copy = (_keys(wanted) != _keys(ends)) & np.isin(_keys(wanted), _keys(ends))
    along = [nodes_on_edges(one[is_copy], cells, count, degree)[:, 1:-1].reshape(-1) for one in (ends, wanted)]
    return np.column_stack(along)


def corners_of(lattice: Mesh, degree: int) -> Mesh:
    """The grid whose :func:`lattice_of` this is."""
    return Mesh(*(q[::degree, ::degree].copy() for q in (lattice.x, lattice.y)))


def nodes_of_elements(mesh: Mesh, degree: ValueDegree) -> tuple[int, ...]:
    """The :func:`~equimesh_coupling.elements.element_shape` of values at the nodes of elements of a ``degree``."""
    return element_shape(mesh, degree)


def nodes_of_cells(mesh: Mesh, degree: int = 2) -> IntArray:
    """The numbers of the nodes of each cell among flat values, in rows along t, shape ``(m, p + 1, p + 1)``."""
    if not mesh.is_grid:
        return element_numbers(mesh.cells, len(mesh.points), degree)
    n_xi, n_eta = element_shape(mesh, degree)
    first, own = (
        np.arange(0, n_xi - 1, degree)[:, None] * n_eta + np.arange(0, n_eta - 1, degree),
        np.arange(degree + 1),
    )
    return np.asarray(first.reshape(-1, 1, 1) + own[:, None] * n_eta + own)


def require_degree(degree: Any, cells: object = "quad") -> ValueDegree:
    """The degree; raises :class:`~equimesh.errors.InputError` for elements from whose values nothing is recovered."""
    if cells not in tuple(MAX_DEGREES):
        raise InputError(f"cells = {str(cells)[:20]!r}: choose 'quad' or 'triangle'", field="cells")
    most = MAX_DEGREES["triangle"]
    if cells == "triangle" and degree in get_args(ValueDegree) and degree > most:
        raise InputError(
            f"degree = {degree}: on triangles elements have degree 1 or {most}; take it, or quadrilaterals",
            field="degree",
        )
    if degree in get_args(ValueDegree) and not isinstance(degree, bool):
        found: ValueDegree = int(degree)  # type: ignore[assignment]
        return found
    raise InputError(
        f"degree = {degree!r:.20}: give 1 to {MAX_DEGREE}, the degree of the elements at whose nodes values are",
        field="degree",
    )
