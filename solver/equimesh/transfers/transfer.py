"""Fields of a mesh on another mesh of the same domain, each carried in its own way.

*Conservative.* The integral that is kept is that over the straight-edged cells: of averages, the sum of averages times
areas; of values at nodes, the integral of the bilinear function, which is that of bilinear elements with a consistent
or a lumped mass matrix. Where the sides of the domain are straight, both meshes cover it, and old and new integral
agree to rounding. Where a side is curved, straight edges cut it differently in each mesh. A cell of the new mesh that
reaches beyond the old one has the mean of its covered part there. Then the integral over all cells is brought to the
old one: first by the averages at these sides, then by all, each within its bounds and by the same share of its room.
Bounds come first: a constant stays constant, although the area differs. :func:`~equimesh.transfers.integrals.integral`
measures what is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from equimesh.errors import SamplesError
from equimesh.fields.mesh_map import MeshMap, through
from equimesh.fields.nodal_field import in_cells
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import describe_value
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import joined
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.types import Array
from equimesh.transfers.integrals import total
from equimesh.transfers.mesh_values import MeshValues, mesh_values
from equimesh.transfers.one_domain import have_seams, require_one_domain
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.repair import repair, share_out
from equimesh.transfers.slopes import slopes_of_averages, slopes_of_nodes

# The conservative transfer of averages over cells.


def transfer_averages(overlaps: Overlaps, averages: Array, bounds: tuple[float, float] | None = None) -> Array:
    """Averages over the old cells as averages over the new ones, flat.

    In each old cell the function is linear with limited slopes; the integrals over the common parts of old and new
    cells are exact. Every new average therefore lies between the bounds of the old cells that it meets, and between
    ``bounds``, or the least and the largest old average. Where a side is curved, the two meshes cover slightly
    different areas, and the integral over all cells is brought to the old one within these bounds:
    see :mod:`~equimesh.transfers.transfer`.
    """
    least, most = float(averages.min()), float(averages.max())
    if bounds is not None:  # values may be beyond them by rounding
        least, most = min(least, bounds[0]), max(most, bounds[1])
    old = overlaps.old
    slopes, (lowest, highest) = slopes_of_averages(old, averages, least, most)
    low, high = overlaps.bounds(lowest, highest)
    moved = np.clip(overlaps.integrals(averages, slopes) / overlaps.new.area, low, high)
    aim = total(old.area, averages)
    beyond = overlaps.beyond != 0.0
    if beyond.any():  # at first only the cells at the curved sides change
        share_out(moved, overlaps.new.area, np.where(beyond, low, moved), np.where(beyond, high, moved), aim)
    share_out(moved, overlaps.new.area, low, high, aim)
    return moved


# The conservative transfer of values at nodes.


def transfer_nodal(overlaps: Overlaps, values: Array, interpolated: Array) -> Array:
    """Values at the old nodes as values at the new ones, flat, with the same integral; tied nodes have one value.

    The integral is that of the bilinear function, the sum of the values times the weights of
    :meth:`~equimesh.transfers.integrals.Cells.node_weights`; the consistent and the lumped mass matrix of bilinear
    elements have the same one.

    The integral over each new cell is known: from that over each old cell, and the mean slope there, over the common
    parts of both. ``interpolated`` are values of high order at the new nodes. What they lack of the integral of a cell
    goes to its four nodes, in proportion to their weights. Each value lies between the least and the largest value of
    the old cells that meet the new cells around it; what is beyond is given to neighbours, see
    :func:`~equimesh.transfers.repair.repair`. Values on a mesh that does not change stay as they are.
    """
    old, new = overlaps.old, overlaps.new
    of_corners = old.at_corners(values)
    means = np.sum(old.weights * of_corners, axis=1) / old.area
    integrals = overlaps.integrals(means, slopes_of_nodes(old, of_corners, means))
    low, high = overlaps.bounds(of_corners.min(axis=1), of_corners.max(axis=1))
    lowest, highest = new.around_nodes(low, np.minimum), new.around_nodes(high, np.maximum)
    moved = np.clip(interpolated, lowest, highest)
    lacking = integrals - np.sum(new.weights * new.at_corners(moved), axis=1)
    weights = new.node_weights
    moved += new.at_nodes(new.weights * (lacking / new.area)[:, None]) / weights
    repair(moved, weights, lowest, highest, new.links)
    share_out(moved, weights, lowest, highest, total(old.node_weights, values))
    return moved


# The smooth transfer of values at nodes: bicubic splines over the grid, cubics on the edges of blocks.

MAX_BEYOND = 0.25
"""How far, as a share of a cell, the cubics go on where a curved side lies beyond the edges of the mesh."""


def transfer_spline(
    mesh: Mesh, fields: Mapping[str, Array], new_mesh: Mesh, known: MeshMap | None = None
) -> dict[str, Array]:
    """Values at the nodes of ``mesh``, shape ``(n_xi, n_eta, ...)``, interpolated to those of ``new_mesh``, by name.

    As :class:`~equimesh.fields.nodal_field.NodalField`: accurate to O(h^4), exact for linear functions; not monotone,
    so that an under-resolved front may overshoot by a few percent, and integrals are kept to the order only. ``known``
    is the map of ``mesh``, where somebody has it.
    """
    if not mesh.is_grid:
        return _by_cubics(mesh, fields, new_mesh)
    places = (known or MeshMap.of(mesh)).locate(new_mesh.x, new_mesh.y)
    rough = np.flatnonzero(~places.smooth)
    moved = {}
    for name, values in fields.items():
        target = np.empty(new_mesh.x.shape + values.shape[2:])
        for index in np.ndindex(*values.shape[2:]):
            part = np.ascontiguousarray(values[(..., *index)])
            (found,) = through(part).evaluate(places.s, places.t)
            if rough.size:
                found[rough] = in_cells(mesh, part, places, rough)[0]
            target[(..., *index)] = found.reshape(new_mesh.x.shape)
        moved[name] = target
    return moved


def _by_cubics(mesh: Mesh, fields: Mapping[str, Array], new_mesh: Mesh) -> dict[str, Array]:
    """The fields carried from a mesh of quadrilaterals by cubics on its edges."""
    unrolled = Unrolled.of(mesh)
    places, moved = unrolled.search.find(new_mesh.x, new_mesh.y, MAX_BEYOND), {}
    for name, values in fields.items():
        target = np.empty(new_mesh.node_shape + values.shape[1:])
        for index in np.ndindex(*values.shape[1:]):
            u = QuadField(mesh=mesh, values=values[(..., *index)], limited=False, unrolled=unrolled)
            target[(..., *index)] = u.at(places)[0].reshape(new_mesh.node_shape)
        moved[name] = target
    return moved


def transfer(mesh: Mesh, fields: Mapping[str, Any], new_mesh: Mesh) -> dict[str, Array]:
    """Fields of ``mesh`` on ``new_mesh``, by their names, in the shapes of that mesh.

    A field is an array of shape ``(n_xi, n_eta)`` or ``(n_xi, n_eta, components)`` at the nodes, which is carried by
    splines, or a :class:`~equimesh.transfers.mesh_values.MeshValues`, which says how. Splines are accurate to O(h^4),
    exact for linear functions, and not monotone: an under-resolved front may overshoot by a few percent. The
    conservative transfer keeps integrals and bounds. Where the field is smooth it is of second order: for values at
    nodes in every norm, for averages in L1 and L2. The largest error of averages is of first order, because bounds
    flatten the largest and the least values; ``bounds`` that are wider than the values avoid this at the sides.

    Raises :class:`~equimesh.errors.SamplesError`, which names the first bad index, for values that do not fit the mesh,
    and :class:`~equimesh.errors.InputError` for a folded mesh, for one of less than 4 nodes in a direction, and for
    meshes of different domains: a side that is straight must be the same up to rounding, a curved one up to what
    straight edges cut off. Fields of solutions on closed grid lines cross the seam.
    """
    require_one_domain(mesh, new_mesh)
    return carry(mesh, named(fields), new_mesh)


def named(fields: Any) -> dict[str, MeshValues]:
    """The fields by their names; raises :class:`~equimesh.errors.SamplesError` for what is no mapping."""
    if not isinstance(fields, Mapping):
        raise SamplesError(
            f"the fields are {describe_value(fields)}: give them by their names, as {{'u': values}}", field="fields"
        )
    return {name: mesh_values(field) for name, field in fields.items()}


def carry(
    mesh: Mesh, given: Mapping[str, MeshValues], new_mesh: Mesh, known: MeshMap | None = None
) -> dict[str, Array]:
    """The fields on the new mesh, as by :func:`transfer`, between two valid meshes of one domain.

    ``known`` is the map of the first, where somebody has it.
    """
    checked = {name: field.on(mesh, name) for name, field in given.items()}
    if not checked:
        return {}
    if have_seams(mesh, new_mesh):
        return _carry_across_seams((mesh, new_mesh), checked, given)
    at_nodes = {name: values for name, values in checked.items() if given[name].location == "nodes"}
    moved = transfer_spline(mesh, at_nodes, new_mesh, known) if at_nodes else {}
    if any(field.transfer == "conservative" for field in given.values()):
        overlaps = Overlaps.of(mesh, new_mesh)
        for name, field in given.items():
            if field.transfer == "conservative":
                moved[name] = _conserved(overlaps, field, checked[name], moved.get(name), (mesh, new_mesh))
    return {name: moved[name] for name in given}


def _carry_across_seams(
    meshes: tuple[Mesh, Mesh], checked: Mapping[str, Array], given: Mapping[str, MeshValues]
) -> dict[str, Array]:
    """The ``checked`` fields between two grids with closed lines, whose copies of nodes become one for it."""
    mesh, new_mesh = meshes
    old, new = joined(mesh), joined(new_mesh)
    flat = {name: replace(field, values=_flat(field, checked[name], old)) for name, field in given.items()}
    return {
        name: values[new.blocks[0]]
        if given[name].location == "nodes"
        else values.reshape(*new_mesh.cell_shape, *values.shape[1:])
        for name, values in carry(old, flat, new).items()
    }


def _flat(field: MeshValues, values: Array, joined_mesh: Mesh) -> Array:
    """The values on a grid as those on the same mesh with one number for each node."""
    if field.location == "cells":
        return values.reshape(-1, *values.shape[2:])
    flat = np.empty((*joined_mesh.node_shape, *values.shape[2:]))
    flat[joined_mesh.blocks[0]] = values
    return flat


def _conserved(
    overlaps: Overlaps, field: MeshValues, values: Array, interpolated: Array | None, meshes: tuple[Mesh, Mesh]
) -> Array:
    """One field of the first of two ``meshes`` on the second one, each component by itself."""
    old, new, axes = overlaps.old, overlaps.new, len(meshes[0].node_shape)
    shape = meshes[1].cell_shape if interpolated is None else meshes[1].node_shape
    moved = np.empty(shape + values.shape[axes:])
    for index in np.ndindex(*values.shape[axes:]):
        part = np.ravel(values[(..., *index)])
        if interpolated is None:
            found = transfer_averages(overlaps, part, field.bounds)
        else:
            rough = np.ravel(interpolated[(..., *index)])
            found = transfer_nodal(overlaps, part[old.kept], rough[new.kept])[new.number]
        moved[(..., *index)] = found.reshape(shape)
    return moved
