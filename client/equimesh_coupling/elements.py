"""The nodes of elements of degree 2 to 4 on a mesh, and values at them from those at places of another library."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, IntArray
from equimesh_coupling.recovery import unique_edges

MAX_DISTANCE_SHARE = 1e-9
"""The largest distance of a place from the node that it is, as a share of the extents of the mesh."""


MAX_DEGREE = 4
"""The highest degree of elements from whose values the next mesh follows; on blocks it is 2."""


@cache
def lobatto(degree: int) -> Array:
    """The ``degree + 1`` Gauss-Lobatto points of the unit interval, where elements have their nodes."""
    inner = np.polynomial.legendre.Legendre.basis(degree).deriv().roots().real
    return np.concatenate([[0.0], 0.5 + 0.5 * np.sort(inner), [1.0]])


class PlacedValues(NamedTuple):
    """The ``values`` of a field, shape ``(k,)``, at its own ``places``, shape ``(k, 2)``, in any order."""

    places: Array
    values: Array
    degree: int = 2
    """The degree of its elements."""


def is_known(degree: object, mesh: HasParts) -> bool:
    """Whether fields of this degree are adapted to by their values at all nodes of elements."""
    most = 2 if mesh.mesh_parts("quad").shape is None else MAX_DEGREE
    return isinstance(degree, int) and 2 <= degree <= most


def element_shape(mesh: HasParts, degree: int) -> tuple[int, ...]:
    """The shape of values at the nodes of elements of a ``degree``, 1 to 4, on the quadrilaterals of ``mesh``.

    On a grid it is ``(p (n_xi - 1) + 1, p (n_eta - 1) + 1)`` for degree p: every p-th one is at a node of the mesh, the
    others are at the Gauss-Lobatto points of edges and cells. On blocks, for degree 2, it is the number of nodes, edges
    and cells. Raises :class:`BadValues` for a higher degree there.
    """
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.node_shape
    if parts.shape is not None:
        return degree * (parts.shape[0] - 1) + 1, degree * (parts.shape[1] - 1) + 1
    if degree > 2:
        raise BadValues(f"elements of degree {degree}: on blocks the next mesh follows from those of degree 1 or 2")
    return (len(parts.points) + len(unique_edges(parts.cells)[0]) + len(parts.cells),)


def element_points(mesh: HasParts, degree: int) -> Array:
    """The nodes of elements of a ``degree``, 1 to 4, on the quadrilaterals of ``mesh``, shape ``(k, 2)``.

    They are in the order of flat values. On blocks those are the nodes of the mesh, then the middles of the edges in
    rising order of their lower and their higher node, then the centres of the cells.
    """
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.points
    if parts.shape is None:
        element_shape(mesh, degree)
        edges, _ = unique_edges(parts.cells)
        middles, centres = parts.points[edges].mean(axis=1), parts.points[parts.cells].mean(axis=1)
        return np.concatenate([parts.points, middles, centres])
    points = parts.points.reshape(*parts.shape, 2)
    return lattice_between(lattice_between(points, degree).swapaxes(0, 1), degree).swapaxes(0, 1).reshape(-1, 2)


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
    points, shape = element_points(mesh, degree), element_shape(mesh, degree)
    found = _places_of(points, placed.places)
    missing = int((found < 0).sum())
    if missing:
        raise BadValues(
            f"the field has {len(placed.places)} values, and none at {missing} of the {math.prod(shape)} nodes that"
            f" elements of degree {degree} have on this mesh: return a field of degree {degree} on the quadrilaterals"
            " of this mesh, of degree 3 and 4 with its nodes at Gauss-Lobatto points"
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
