"""The smooth transfer of values at nodes: bicubic splines over the grid, cubics on the edges of blocks."""

from collections.abc import Mapping

import numpy as np

from equimesh.fields.mesh_map import MeshMap, through
from equimesh.fields.nodal_field import in_cells
from equimesh.fields.quad_field import QuadField
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.types import Array

MAX_BEYOND = 0.25
"""How far, as a share of a cell, the cubics go on where a curved side lies beyond the edges of the mesh."""


def transfer_spline(mesh: Mesh | QuadMesh, fields: Mapping[str, Array], new_mesh: Mesh | QuadMesh) -> dict[str, Array]:
    """Values at the nodes of ``mesh``, shape ``(n_xi, n_eta, ...)``, interpolated to those of ``new_mesh``, by name.

    As :class:`~equimesh.fields.nodal_field.NodalField`: accurate to O(h^4), exact for linear functions; not monotone,
    so that an under-resolved front may overshoot by a few percent, and integrals are kept to the order only.
    """
    if isinstance(mesh, QuadMesh):
        return _by_cubics(mesh, fields, new_mesh)
    places = MeshMap.of(mesh).locate(new_mesh.x, new_mesh.y)
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


def _by_cubics(mesh: QuadMesh, fields: Mapping[str, Array], new_mesh: Mesh | QuadMesh) -> dict[str, Array]:
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
