"""The smooth transfer of values at nodes: bicubic splines over the grid."""

from collections.abc import Mapping

import numpy as np

from equimesh.fields.mesh_map import MeshMap, through
from equimesh.fields.nodal_field import in_cells
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array


def transfer_spline(mesh: Mesh, fields: Mapping[str, Array], new_mesh: Mesh) -> dict[str, Array]:
    """Values at the nodes of ``mesh``, shape ``(n_xi, n_eta, ...)``, interpolated to those of ``new_mesh``, by name.

    As :class:`~equimesh.fields.nodal_field.NodalField`: accurate to O(h^4), exact for linear functions; not monotone,
    so that an under-resolved front may overshoot by a few percent, and integrals are kept to the order only.
    """
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
