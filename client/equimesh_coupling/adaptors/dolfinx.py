"""FEniCSx: a ``dolfinx.mesh.Mesh`` with tags of its boundary facets, and functions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.libraries import library
from equimesh_coupling.parts import TAGS, Array, HasParts, MeshParts

OLDEST: Final = "0.5"
INSTALL: Final = "apt-get install python3-dolfinx, or conda install -c conda-forge fenics-dolfinx"
# Dolfinx counts the corners of a quadrilateral along x first, not around it.
QUAD_ORDER: Final = (0, 1, 3, 2)


def mesh_of(parts: MeshParts, comm: Any) -> tuple[Any, Any]:
    """The mesh of dolfinx on the processes of ``comm``, and the tags of its facets: 1 left, 2 right, 3 bottom, 4 top.

    Every process gives the same arrays; the first hands out the cells. Dolfinx renumbers the nodes:
    ``mesh.geometry.input_global_indices`` has their numbers here.
    """
    dolfinx = library("dolfinx", package="fenics-dolfinx", at_least=OLDEST, install=INSTALL)
    dolfinx_mesh = library("dolfinx.mesh", package="dolfinx", install=INSTALL)
    graph = library("dolfinx.graph", package="dolfinx", install=INSTALL)
    io = library("dolfinx.io", package="dolfinx", install=INSTALL)
    kind, order = ("triangle", (0, 1, 2)) if parts.is_triangular else ("quadrilateral", QUAD_ORDER)
    here = comm.rank == 0
    cells = parts.cells[:, order] if here else np.empty((0, len(order)), dtype=np.int64)
    points = parts.points if here else np.empty((0, 2))
    mesh = dolfinx_mesh.create_mesh(comm, cells, points, _coordinate_element(kind))
    mesh.topology.create_connectivity(1, 0)
    edges = np.concatenate([*parts.sides.values()]) if here else np.empty((0, 2), dtype=np.int64)
    tags = np.concatenate([np.full(len(edge), TAGS[side], dtype=np.int32) for side, edge in parts.sides.items()])
    given = io.distribute_entity_data(mesh, 1, edges, tags if here else tags[:0])
    adjacency = getattr(graph, "create_adjacencylist", None) or graph.adjacencylist
    del dolfinx
    return mesh, dolfinx_mesh.meshtags_from_entities(mesh, 1, adjacency(given[0]), given[1])


def _coordinate_element(kind: str) -> Any:
    """The element of the geometry: of basix where UFL is new, else of UFL."""
    try:
        basix = library("basix.ufl", package="fenics-basix", install=INSTALL)
        return basix.element("Lagrange", kind, 1, shape=(2,))
    except ImportError:
        ufl = library("ufl", package="fenics-ufl", install=INSTALL)
        return ufl.Mesh(ufl.VectorElement("Lagrange", kind, 1))


def nodal_values(function: Any, mesh: HasParts) -> Array:
    """The values at the nodes, shape ``(n_xi, n_eta)``, of a scalar Lagrange function of dolfinx of order 1.

    It takes functions of a mesh on one process. Raises :class:`BadValues` for another space or mesh.
    """
    parts = mesh.mesh_parts()
    space = function.function_space
    geometry = space.mesh.geometry
    numbers = np.asarray(geometry.input_global_indices)
    values = np.asarray(function.x.array)
    if not len(numbers) == len(values) == len(parts.points):
        raise BadValues(
            f"the function of dolfinx has {len(values)} values here, and this mesh {len(parts.points)} nodes: return a "
            "scalar Lagrange function of order 1 of a mesh on one process"
        )
    vertices = np.asarray(getattr(geometry.dofmap, "array", geometry.dofmap)).ravel()
    dofs = np.asarray(getattr(space.dofmap.list, "array", space.dofmap.list)).ravel()
    found = np.empty(len(values))
    found[numbers[vertices]] = np.real(values[dofs])
    return found.reshape(parts.shape)
