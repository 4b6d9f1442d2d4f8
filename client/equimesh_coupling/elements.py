"""The nodes of elements of degree 2 on a mesh, and values at them from those at the places of another library."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, IntArray
from equimesh_coupling.recovery import unique_edges

MAX_DISTANCE_SHARE = 1e-9
"""The largest distance of a place from the node that it is, as a share of the extents of the mesh."""


class PlacedValues(NamedTuple):
    """The ``values`` of a field of degree 2, shape ``(k,)``, at its own ``places``, shape ``(k, 2)``, in any order."""

    places: Array
    values: Array


def element_shape(mesh: HasParts, degree: int) -> tuple[int, ...]:
    """The shape of values at the nodes of elements of a ``degree``, 1 or 2, on the quadrilaterals of ``mesh``.

    Of degree 2 it is ``(2 n_xi - 1, 2 n_eta - 1)`` on a grid, where every second one is at a node of the mesh and the
    others are in the middle of edges and cells. On blocks it is the number of nodes, edges and cells.
    """
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.node_shape
    if parts.shape is not None:
        return 2 * parts.shape[0] - 1, 2 * parts.shape[1] - 1
    return (len(parts.points) + len(unique_edges(parts.cells)[0]) + len(parts.cells),)


def element_points(mesh: HasParts, degree: int) -> Array:
    """The nodes of elements of a ``degree``, 1 or 2, on the quadrilaterals of ``mesh``, shape ``(k, 2)``.

    They are in the order of flat values. On blocks those are the nodes of the mesh, then the middles of the edges in
    rising order of their lower and their higher node, then the centres of the cells.
    """
    parts = mesh.mesh_parts("quad")
    if degree == 1:
        return parts.points
    edges, _ = unique_edges(parts.cells)
    middles, centres = parts.points[edges].mean(axis=1), parts.points[parts.cells].mean(axis=1)
    if parts.shape is None:
        return np.concatenate([parts.points, middles, centres])
    n_xi, n_eta = parts.shape
    lattice = np.empty((2 * n_xi - 1, 2 * n_eta - 1, 2))
    lattice[::2, ::2] = parts.points.reshape(n_xi, n_eta, 2)
    lattice[1::2, ::2] = 0.5 * (lattice[2::2, ::2] + lattice[:-1:2, ::2])
    lattice[:, 1::2] = 0.5 * (lattice[:, 2::2] + lattice[:, :-1:2])
    return lattice.reshape(-1, 2)


def at_elements(placed: PlacedValues, mesh: HasParts) -> Array:
    """The values at the nodes of elements of degree 2, in their :func:`element_shape`.

    Raises :class:`BadValues` where a node has no value.
    """
    points, shape = element_points(mesh, 2), element_shape(mesh, 2)
    found = _places_of(points, placed.places)
    missing = int((found < 0).sum())
    if missing:
        raise BadValues(
            f"the field has {len(placed.places)} values, and none at {missing} of the {math.prod(shape)} nodes that"
            " elements of degree 2 have on this mesh: return a field of degree 2 on the quadrilaterals of this mesh"
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
