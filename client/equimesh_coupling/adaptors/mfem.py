"""MFEM, by its Python package PyMFEM: a serial ``Mesh``, and grid functions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.elements import PlacedValues, is_known
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, Cells, HasParts, MeshParts

OLDEST: Final = "4.7"
INSTALL: Final = f"pip install 'mfem>={OLDEST}'"


def mesh_of(parts: MeshParts) -> Any:
    """The mesh of MFEM, with the number of each side, from 1, as its boundary attribute; node ``k`` is vertex ``k``.

    A grid has 1 left, 2 right, 3 bottom, 4 top.
    """
    mfem = library("mfem.ser", package="mfem", at_least=OLDEST, install=INSTALL)
    edges = sum(len(side) for side in parts.sides.values())
    mesh = mfem.Mesh(2, len(parts.points), len(parts.cells), edges, 2)
    for x, y in parts.points.tolist():
        mesh.AddVertex(x, y)
    add = mesh.AddTriangle if parts.is_triangular else mesh.AddQuad
    for cell in parts.cells.tolist():
        add(*cell)
    for number, edges_of_side in enumerate(parts.sides.values(), start=1):
        for edge in edges_of_side.tolist():
            mesh.AddBdrSegment(*edge, number)
    mesh.FinalizeTopology()
    mesh.Finalize(False, True)
    return mesh


def placed_values(field: Any, _: HasParts) -> PlacedValues | None:
    """The values at the nodes of a scalar H1 ``GridFunction`` of order 2 to 4, on triangles 2; else ``None``."""
    mfem = library("mfem.ser", package="mfem", at_least=OLDEST, install=INSTALL)
    space = field.FESpace()
    collection, mesh = space.FEColl(), space.GetMesh()
    degree, is_scalar = collection.GetOrder(), collection.Name().startswith("H1") and space.GetVDim() == 1
    kind: Cells = "quad" if mesh.GetElementType(0) == mfem.Element.QUADRILATERAL else "triangle"
    if not (is_scalar and is_known(degree, kind)):
        return None
    vectors = mfem.FiniteElementSpace(mesh, collection, 2, mfem.Ordering.byNODES)
    nodes = mfem.GridFunction(vectors)  # which does not keep its space
    mesh.GetNodes(nodes)
    return PlacedValues(np.array(nodes.GetDataArray()).reshape(2, -1).T, np.array(field.GetDataArray()), degree, kind)


def nodal_values(field: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of a scalar ``GridFunction`` of MFEM, of any order.

    Raises :class:`BadValues` for another mesh and for a field that is discontinuous or has components.
    """
    parts = mesh.mesh_parts()
    mfem = library("mfem.ser", package="mfem", at_least=OLDEST, install=INSTALL)
    space = field.FESpace()
    nodes = space.GetMesh().GetNV()
    collection = space.FEColl()
    is_nodal = collection.Name().startswith("H1") and space.GetVDim() == 1
    if nodes != len(parts.points) or not is_nodal:
        raise BadValues(
            f"the grid function of MFEM has collection {collection.Name()}, {space.GetVDim()} components and {nodes} "
            f"vertices: return a scalar H1 function on this mesh of {len(parts.points)} nodes"
        )
    values = mfem.Vector()
    field.GetNodalValues(values, 1)
    return np.array(values.GetDataArray(), dtype=np.float64).reshape(parts.node_shape)
