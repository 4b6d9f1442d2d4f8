"""PETSc: a ``DMPlex`` with labels of its boundary, and vectors on it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, HasParts, MeshParts

OLDEST: Final = "3.15"
INSTALL: Final = "apt-get install python3-petsc4py, or pip install petsc petsc4py"


def mesh_of(parts: MeshParts, comm: Any) -> Any:
    """The ``DMPlex`` of PETSc on ``comm``; its label ``Face Sets`` has the numbers of the sides, from 1.

    A grid has 1 left, 2 right, 3 bottom, 4 top.
    """
    petsc = library("petsc4py.PETSc", package="petsc4py", at_least=OLDEST, install=INSTALL)
    here = comm.getRank() == 0 if hasattr(comm, "getRank") else comm.rank == 0
    cells, points = (parts.cells, parts.points) if here else (parts.cells[:0], parts.points[:0])
    plex = petsc.DMPlex().createFromCellList(2, cells.astype(petsc.IntType), points, interpolate=True, comm=comm)
    plex.createLabel("Face Sets")
    first = plex.getDepthStratum(0)[0]
    for number, edges in enumerate(parts.sides.values() if here else (), start=1):
        for edge in np.asarray(edges).tolist():
            (face,) = plex.getJoin([first + node for node in edge])
            plex.setLabelValue("Face Sets", face, number)
    return plex


def nodal_values(field: tuple[Any, Any], mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of ``(plex, vector)`` with one value at each vertex.

    The local section of the ``DMPlex`` says where the values are. It takes a mesh on one process. Raises
    :class:`BadValues` for another section, mesh or length.
    """
    parts = mesh.mesh_parts()
    plex, vector = field
    section = (getattr(plex, "getLocalSection", None) or plex.getSection)()  # the older name
    first, end = plex.getDepthStratum(0)
    if end - first != len(parts.points) or any(section.getDof(vertex) != 1 for vertex in range(first, end)):
        raise BadValues(
            f"the DMPlex needs one value at each of {len(parts.points)} vertices: return a field of a scalar Lagrange "
            "element of order 1 of a mesh on one process"
        )
    values = np.asarray(vector.getArray(readonly=True))
    places = np.array([section.getOffset(vertex) for vertex in range(first, end)])
    if len(values) != section.getStorageSize():
        raise BadValues(
            f"the vector has {len(values)} entries, and the section of its DMPlex {section.getStorageSize()}: return a "
            "local vector of this DMPlex"
        )
    return np.asarray(values[places]).reshape(parts.node_shape)
