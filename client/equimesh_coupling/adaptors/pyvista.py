"""PyVista: an ``UnstructuredGrid``, and arrays of its points."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, HasParts, MeshParts

OLDEST: Final = "0.40"
INSTALL: Final = f"pip install 'pyvista>={OLDEST}'"


def mesh_of(parts: MeshParts) -> Any:
    """The grid of PyVista with third coordinate 0; ``field_data`` has the edges of each side, shape ``(k, 2)``."""
    pyvista = library("pyvista", at_least=OLDEST, install=INSTALL)
    kind = pyvista.CellType.TRIANGLE if parts.is_triangular else pyvista.CellType.QUAD
    grid = pyvista.UnstructuredGrid({kind: parts.cells}, np.pad(parts.points, ((0, 0), (0, 1))))
    for side, edges in parts.sides.items():
        grid.field_data[side] = edges
    return grid


def nodal_values(grid: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of the active scalars of a ``grid`` of PyVista.

    A single array ``grid.point_data["u"]`` needs no adaptor: it has the order of the nodes. Raises
    :class:`BadValues` where there are no active scalars at the points of this mesh.
    """
    parts = mesh.mesh_parts()
    name = grid.point_data.active_scalars_name
    values = None if name is None else np.asarray(grid.point_data[name])
    if values is None or values.shape != (len(parts.points),):
        raise BadValues(
            f"the grid of PyVista has no active scalars at the {len(parts.points)} nodes of this mesh: return "
            'grid.point_data["u"], with your name'
        )
    return values.reshape(parts.node_shape)
