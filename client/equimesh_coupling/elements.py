"""The nodes of elements of degree 2 to 4 on a mesh, and values at them from those at places of another library."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, Cells, HasParts, IntArray, cut_ends
from equimesh_coupling.recovery import edge_numbers, unique_edges

MAX_DISTANCE_SHARE = 1e-9
"""The largest distance of a place from the node that it is, as a share of the extents of the mesh."""


MAX_DEGREE = 4
"""The highest degree of elements from whose values the next mesh follows."""
MAX_DEGREES: Mapping[Cells, int] = {"quad": MAX_DEGREE, "triangle": 2}
"""The same on each kind of cells."""


@cache
def lobatto(degree: int) -> Array:
    """The ``degree + 1`` Gauss-Lobatto points of the unit interval, where elements have their nodes."""
    inner = np.polynomial.legendre.Legendre.basis(degree).deriv().roots().real
    return np.concatenate([[0.0], 0.5 + 0.5 * np.sort(inner), [1.0]])


WORDS: Mapping[Cells, str] = {"quad": "quadrilaterals", "triangle": "triangles"}
"""The kinds of cells in sentences."""


@cache
def gauss(count: int) -> tuple[Array, Array]:
    """The Gauss points of the unit interval, and their weights."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (1.0 + points), 0.5 * weights


def lagrange_functions(degree: int, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """The functions of an element at places in the unit square, and their derivatives along s and t.

    The first axis is that of the nodes, in rows along t.
    """
    (a, da), (b, db) = _along(degree, s), _along(degree, t)
    values, along_s, along_t = (
        np.reshape(p[:, None] * q[None, :], (-1, *s.shape)) for p, q in ((a, b), (da, b), (a, db))
    )
    return values, along_s, along_t


def _along(degree: int, q: Array) -> tuple[Array, Array]:
    """The Lagrange polynomials of the Gauss-Lobatto points, and their derivatives, at some points of an interval."""
    nodes = lobatto(degree)
    values, slopes = np.empty((2, nodes.size, *q.shape))
    for k, node in enumerate(nodes):
        roots = np.delete(nodes, k)
        parts = [(q - root) / (node - root) for root in roots]
        values[k] = np.prod(parts, axis=0)
        slopes[k] = sum(
            np.prod([part for other, part in enumerate(parts) if other != one] or [np.ones_like(q)], axis=0)
            / (node - roots[one])
            for one in range(roots.size)
        )
    return values, slopes


class PlacedValues(NamedTuple):
    """The ``values`` of a field, shape ``(k,)``, at its own ``places``, shape ``(k, 2)``, in any order."""

    places: Array
    values: Array
    degree: int = 2
    """The degree of its elements."""
    cells: Cells = "quad"
    """The cells of its elements: quadrilaterals, or the triangles that these are cut into."""


def is_known(degree: object, cells: Cells = "quad") -> bool:
    """Whether fields of this degree are adapted to by their values at all nodes of elements."""
    return isinstance(degree, int) and 2 <= degree <= MAX_DEGREES[cells]


def element_shape(mesh: HasParts, degree: int) -> tuple[int, ...]:
    """The shape of values at the nodes of elements of a ``degree``, 1 to 4, on the quadrilaterals of ``mesh``.

    On a grid it is ``(p (n_xi - 1) + 1, p (n_eta - 1) + 1)`` for degree p: every p-th one is at a node of the mesh, the
    others are at the Gauss-Lobatto points of edges and cells. On blocks it is ``(n + k (p - 1) + m (p - 1)^2,)`` with n
    nodes, k edges and m cells.
    """
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.node_shape
    if parts.shape is not None:
        return degree * (parts.shape[0] - 1) + 1, degree * (parts.shape[1] - 1) + 1
    inner, edges = degree - 1, len(unique_edges(parts.cells)[0])
    return (len(parts.points) + edges * inner + len(parts.cells) * inner**2,)


def element_points(mesh: HasParts, degree: int, cells: Cells = "quad") -> Array:
    """The nodes of elements of a ``degree``, 1 to 4, on the quadrilaterals of ``mesh``, shape ``(k, 2)``.

    They are in the order of flat values. On blocks those are the nodes of the mesh, then those on the edges in rising
    order of their lower and their higher node, from the one to the other, then those in the cells, in rows along t.

    With ``cells="triangle"``, of degree 1 or 2, the elements are the two triangles of each quadrilateral: its inner
    node is then the middle of the diagonal along which it is cut.
    """
    points = _points_of_quads(mesh, degree)
    if cells == "triangle" and degree == 2:
        parts = mesh.mesh_parts("triangle")
        middles = parts.points[cut_ends(parts.cells)].mean(axis=1)
        shape = element_shape(mesh, degree)
        inner = points[-len(middles) :] if parts.shape is None else points.reshape(*shape, 2)[1::2, 1::2]
        inner[:] = middles.reshape(inner.shape)
    return points


def _points_of_quads(mesh: HasParts, degree: int) -> Array:
    """The nodes of elements on the quadrilaterals."""
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.points
    if parts.shape is None:
        ends = np.sort(unique_edges(parts.cells)[0], axis=1)
        on_edges = _between(parts.points[ends[:, 0]], parts.points[ends[:, 1]], degree)
        inside = places_of_cells(parts.points[parts.cells], degree)[:, 1:-1, 1:-1]
        return np.concatenate([parts.points, on_edges[:, 1:-1].reshape(-1, 2), inside.reshape(-1, 2)])
    points = parts.points.reshape(*parts.shape, 2)
    return lattice_between(lattice_between(points, degree).swapaxes(0, 1), degree).swapaxes(0, 1).reshape(-1, 2)


def element_numbers(cells: IntArray, count: int, degree: int) -> IntArray:
    """The nodes of the elements of ``cells`` between ``count`` nodes, in rows along t, shape ``(m, p + 1, p + 1)``.

    Their numbers are those of :func:`element_points` on blocks.
    """
    edges, of_cells = unique_edges(cells)
    ends = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2)
    along = _on_edges(ends, of_cells, count, degree)
    numbers = np.empty((len(cells), degree + 1, degree + 1), dtype=np.int64)
    numbers[:, :, 0], numbers[:, -1] = along[:, 0], along[:, 1]
    numbers[:, :, -1], numbers[:, 0] = along[:, 2, ::-1], along[:, 3, ::-1]
    inside = np.arange(len(cells) * (degree - 1) ** 2).reshape(-1, degree - 1, degree - 1)
    numbers[:, 1:-1, 1:-1] = count + len(edges) * (degree - 1) + inside
    return numbers


def nodes_on_edges(ends: IntArray, cells: IntArray, count: int, degree: int) -> IntArray:
    """The nodes of elements on edges of ``cells``, in the direction of their ``ends``, shape ``(k, p + 1)``."""
    return _on_edges(ends, edge_numbers(ends, unique_edges(cells)[0]), count, degree)


def _on_edges(ends: IntArray, edges: IntArray, count: int, degree: int) -> IntArray:
    """The nodes of elements on the ``edges`` of these numbers, whose two ``ends`` are the last axis."""
    inner = np.arange(degree - 1)
    is_rising = ends[..., :1] < ends[..., 1:]
    between = count + (degree - 1) * edges[..., None] + np.where(is_rising, inner, inner[::-1])
    found: IntArray = np.concatenate([ends[..., :1], between, ends[..., 1:]], axis=-1)
    return found


def places_of_cells(corners: Array, degree: int) -> Array:
    """The nodes of elements in cells with ``corners``, ``(m, 4, 2)``, in rows along t, ``(m, p + 1, p + 1, 2)``."""
    lower, upper = (_between(corners[:, a], corners[:, b], degree) for a, b in ((0, 1), (3, 2)))
    return _between(lower, upper, degree)


def _between(begin: Array, end: Array, degree: int) -> Array:
    """The nodes of elements from ``begin`` to ``end``, points ``(..., 2)``, along the axis before the last."""
    share = lobatto(degree)[:, None]
    found: Array = (1.0 - share) * begin[..., None, :] + share * end[..., None, :]
    return found


def lattice_between(q: Array, degree: int) -> Array:
    """Numbers at the nodes of lines along the first axis, and at the nodes of elements between them."""
    out = np.empty((degree * (len(q) - 1) + 1, *q.shape[1:]))
    for k, share in enumerate(lobatto(degree)[:-1]):
        out[k:-1:degree] = (1.0 - share) * q[:-1] + share * q[1:]
    out[-1] = q[-1]
    return out


def at_elements(placed: PlacedValues, mesh: HasParts) -> Array:
    """The values at the nodes of elements of the degree of ``placed``, in their :func:`element_shape`.

    Raises :class:`BadValues` where a node has no value.
    """
    degree = placed.degree
    points, shape = element_points(mesh, degree, placed.cells), element_shape(mesh, degree)
    found = _places_of(points, placed.places)
    missing = int((found < 0).sum())
    if missing:
        raise BadValues(
            f"the field has {len(placed.places)} values, and none at {missing} of the {math.prod(shape)} nodes that"
            f" elements of degree {degree} have on this mesh: return a field of degree {degree} on the"
            f" {WORDS[placed.cells]} of this mesh, of degree 3 and 4 with its nodes at Gauss-Lobatto points"
        )
    return np.asarray(placed.values)[found].reshape(shape)


def _places_of(points: Array, places: Array) -> IntArray:
    """The number of the place of each point, -1 where there is none.

    Places are looked up by the square in which they lie. A point near an edge of its square is sought on both sides.
    """
    low, size = points.min(axis=0), MAX_DISTANCE_SHARE * float(np.ptp(points, axis=0).max())
    keys = _squares((places - low) / size)
    order = np.argsort(keys)
    found = np.full(len(points), -1)
    for dx in (-0.25, 0.25):
        for dy in (-0.25, 0.25):
            wanted = _squares((points - low) / size + np.array([dx, dy]))
            at = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(order) - 1)]
            found = np.where(keys[at] == wanted, at, found)
    return found


def _squares(scaled: Array) -> IntArray:
    """A number for the square of unit size in which each point lies."""
    squares = np.floor(scaled).astype(np.int64)
    keys: IntArray = squares[:, 0] * (1 << 31) + squares[:, 1]
    return keys
