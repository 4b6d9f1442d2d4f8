"""PETSc: a ``DMPlex`` with labels of its boundary."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.libraries import library
from equimesh_coupling.parts import TAGS, MeshParts

OLDEST: Final = "3.15"
INSTALL: Final = "apt-get install python3-petsc4py, or pip install petsc petsc4py"


def mesh_of(parts: MeshParts, comm: Any) -> Any:
    """The ``DMPlex`` of PETSc on ``comm``; its label ``Face Sets`` has 1 left, 2 right, 3 bottom, 4 top."""
    petsc = library("petsc4py.PETSc", package="petsc4py", at_least=OLDEST, install=INSTALL)
    here = comm.getRank() == 0 if hasattr(comm, "getRank") else comm.rank == 0
    cells = parts.cells if here else parts.cells[:0]
    plex = petsc.DMPlex().createFromCellList(2, cells.astype(petsc.IntType), parts.points, interpolate=True, comm=comm)
    plex.createLabel("Face Sets")
    first = plex.getDepthStratum(0)[0]
    for side, edges in parts.sides.items() if here else ():
        for edge in np.asarray(edges).tolist():
            (face,) = plex.getJoin([first + node for node in edge])
            plex.setLabelValue("Face Sets", face, TAGS[side])
    return plex
