"""FiPy: a ``Mesh2D``, and cell variables."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, HasParts, MeshParts
from equimesh_coupling.recovery import CellAverages, edge_numbers, nodes_from_cells, unique_edges

OLDEST: Final = "3.4.5"
INSTALL: Final = f"pip install 'fipy>={OLDEST}'"


def mesh_of(parts: MeshParts) -> Any:
    """The mesh of FiPy; ``mesh.physicalFaces["left"]`` is a mask of faces, as FiPy's own ``Gmsh2D`` has it."""
    library("fipy", at_least=OLDEST, install=INSTALL)
    mesh_2d = library("fipy.meshes.mesh2D", package="fipy", install=INSTALL)
    edges, of_cells = unique_edges(parts.cells)
    mesh = mesh_2d.Mesh2D(parts.points.T.copy(), edges.T.copy(), of_cells.T.copy())
    masks = np.zeros((len(parts.sides), len(edges)), dtype=bool)
    for mask, side in zip(masks, parts.sides.values(), strict=True):
        mask[edge_numbers(side, edges)] = True
    face_variable = library("fipy.variables.faceVariable", package="fipy", install=INSTALL).FaceVariable
    mesh.physicalFaces = {
        side: face_variable(mesh=mesh, value=mask) for side, mask in zip(parts.sides, masks, strict=True)
    }
    return mesh


def nodal_values(variable: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of a ``CellVariable`` of FiPy.

    FiPy solves for averages over cells: the values at the nodes are recovered as in
    ``equimesh_coupling.recovery.nodes_from_cells``. Raises :class:`BadValues` for another mesh, and for a
    variable with components.
    """
    if variable.rank != 0:
        raise BadValues(f"the variable of FiPy has rank {variable.rank}: return a scalar one")
    return nodes_from_cells(CellAverages(variable.value), mesh)
