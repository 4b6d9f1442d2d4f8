"""SfePy: its ``Mesh``, and field variables."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.elements import PlacedValues
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, HasParts, MeshParts

OLDEST: Final = "2021.1"
INSTALL: Final = f"pip install 'sfepy>={OLDEST}'"


def mesh_of(parts: MeshParts) -> Any:
    """The mesh of SfePy, with the vertices of the sides as sets by name.

    A region is ``domain.create_region("Left", "vertices of set left", "facet")``. Node ``k`` is vertex ``k``.
    """
    fem = library("sfepy.discrete.fem", package="sfepy", at_least=OLDEST, install=INSTALL)
    kind = "2_3" if parts.is_triangular else "2_4"
    vertices = {side: np.unique(edges).astype(np.int32) for side, edges in parts.sides.items()}
    return fem.Mesh.from_data(
        "equimesh",
        parts.points,
        np.zeros(len(parts.points), dtype=np.int32),
        [parts.cells.astype(np.int32)],
        [np.ones(len(parts.cells), dtype=np.int32)],
        [kind],
        nodal_bcs=vertices,
    )


def placed_values(variable: Any, _: HasParts) -> PlacedValues | None:
    """The values at the nodes of a scalar variable of order 2; ``None`` for another space."""
    field = variable.field
    basis = getattr(field, "poly_space_basis", None) or getattr(field, "poly_space_base", "lagrange")
    is_quadratic = field.approx_order == 2 and variable.n_components == 1 and basis == "lagrange"
    if not is_quadratic:
        return None
    places, values = np.asarray(field.get_coor())[:, :2], np.array(variable(), dtype=np.float64)
    return PlacedValues(places, values, cells="quad" if field.gel.name == "2_4" else "triangle")


def nodal_values(variable: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of a scalar ``FieldVariable`` of SfePy.

    Raises :class:`BadValues` for another mesh and for a field with components.
    """
    parts = mesh.mesh_parts()
    field = variable.field
    nodes = field.domain.mesh.n_nod
    if nodes != len(parts.points) or variable.n_components != 1:
        raise BadValues(
            f"the variable of SfePy has {variable.n_components} components and {nodes} vertices: return a scalar one "
            f"on this mesh of {len(parts.points)} nodes"
        )
    values = np.array(variable()[field.vertex_remap], dtype=np.float64)
    return values.reshape(parts.node_shape)
