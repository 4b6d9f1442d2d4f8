"""NGSolve: its ``Mesh``, and grid functions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.elements import PlacedValues, element_points, is_known
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, Cells, HasParts, MeshParts

OLDEST: Final = "6.2.2302"
INSTALL: Final = f"pip install 'ngsolve>={OLDEST}'"


def mesh_of(parts: MeshParts) -> Any:
    """The mesh of NGSolve with a boundary for each side, by its name, and the material ``domain``.

    Node ``k`` is vertex ``k``.
    """
    ngsolve = library("ngsolve", at_least=OLDEST, install=INSTALL)
    netgen = library("netgen.meshing", package="ngsolve", install=INSTALL)
    mesh = netgen.Mesh(dim=2)
    numbers = [mesh.Add(netgen.MeshPoint(netgen.Pnt(x, y, 0.0))) for x, y in parts.points.tolist()]
    mesh.Add(netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
    for cell in parts.cells.tolist():
        mesh.Add(netgen.Element2D(1, [numbers[node] for node in cell]))
    for number, (side, edges) in enumerate(parts.sides.items(), start=1):
        for edge in edges.tolist():
            mesh.Add(netgen.Element1D([numbers[node] for node in edge], index=number))
        mesh.SetBCName(number - 1, side)
    mesh.SetMaterial(1, "domain")
    return ngsolve.Mesh(mesh)


def placed_values(field: Any, mesh: HasParts) -> PlacedValues | None:
    """The values at the nodes of elements of a scalar function on ``H1`` of order 2 to 4, on triangles 2, or ``None``.

    Its degrees of freedom are no values at nodes, so that it is evaluated there.
    """
    space = field.space
    degree, is_scalar = space.globalorder, space.type.startswith("h1") and field.dim == 1
    kind: Cells = "quad" if space.mesh.ne == len(mesh.mesh_parts("quad").cells) else "triangle"
    if not (is_scalar and is_known(degree, kind)):
        return None
    points = element_points(mesh, degree, kind)
    return PlacedValues(points, np.asarray(field(space.mesh(*points.T))).ravel(), degree, kind)


def nodal_values(field: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of a scalar ``GridFunction`` of NGSolve on ``H1``.

    The degrees of freedom of vertices come first, at any order. Raises :class:`BadValues` for another space or mesh.
    """
    parts = mesh.mesh_parts()
    space = field.space
    if space.mesh.nv != len(parts.points) or not space.type.startswith("h1") or field.dim != 1:
        raise BadValues(
            f"the grid function of NGSolve is on the space {space.type} with {space.mesh.nv} vertices: return a scalar "
            f"H1 function on this mesh of {len(parts.points)} nodes"
        )
    values = np.array(field.vec.FV().NumPy()[: len(parts.points)])
    return values.reshape(parts.node_shape)
