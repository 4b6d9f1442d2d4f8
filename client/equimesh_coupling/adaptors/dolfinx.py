"""FEniCSx: a ``dolfinx.mesh.Mesh`` with tags of its boundary facets, and functions."""

from __future__ import annotations

import inspect
from typing import Any, Final

import numpy as np

from equimesh_coupling.elements import PlacedValues, is_known
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, Cells, HasParts, IntArray, MeshParts

OLDEST: Final = "0.5"
INSTALL: Final = "apt-get install python3-dolfinx, or conda install -c conda-forge fenics-dolfinx"
# Dolfinx counts the corners of a quadrilateral along x first, not around it.
QUAD_ORDER: Final = [0, 1, 3, 2]


def mesh_of(parts: MeshParts, comm: Any) -> tuple[Any, Any]:
    """The mesh of dolfinx on the processes of ``comm``, and the tags of its facets.

    The tags are the numbers of the sides, from 1: of a grid 1 left, 2 right, 3 bottom, 4 top. Every process gives the
    same arrays; the first hands out the cells. Dolfinx renumbers the nodes: ``mesh.geometry.input_global_indices`` has
    their numbers here.
    """
    library("dolfinx", package="fenics-dolfinx", at_least=OLDEST, install=INSTALL)
    found = {name: library(f"dolfinx.{name}", package="dolfinx", install=INSTALL) for name in ("mesh", "graph", "io")}
    kind, order = ("triangle", [0, 1, 2]) if parts.is_triangular else ("quadrilateral", QUAD_ORDER)
    here = slice(None if comm.rank == 0 else 0)
    element = _element_argument(found["mesh"].create_mesh, kind)
    cells = np.ascontiguousarray(parts.cells[here, order])
    mesh = found["mesh"].create_mesh(comm, cells=cells, x=np.ascontiguousarray(parts.points[here]), **element)
    mesh.topology.create_connectivity(1, 0)
    mesh.topology.create_connectivity(1, 2)
    edges = np.concatenate([np.empty((0, 2), np.int64), *parts.sides.values()])
    tags = np.repeat(np.arange(1, len(parts.sides) + 1, dtype=np.int32), [*map(len, parts.sides.values())])
    nodes, values = _distributed(found["io"], mesh, edges[here], tags[here])
    lists = getattr(found["graph"], "adjacencylist", None) or found["graph"].create_adjacencylist
    facets = found["mesh"].meshtags_from_entities(mesh, 1, lists(nodes), values)
    facets.name = "sides"
    return mesh, facets


def _element_argument(create_mesh: Any, kind: str) -> dict[str, Any]:
    """The geometry's element, under the name that this version of ``create_mesh`` gives it.

    Up to 0.7 it is the ``domain``, a mesh of UFL; later it is ``e``, an element of basix, and 0.10 has it before ``x``.
    """
    ufl = library("ufl", package="fenics-ufl", install=INSTALL)
    try:
        basix = library("basix.ufl", package="fenics-basix", install=INSTALL)
        element = basix.element("Lagrange", kind, 1, shape=(2,))
    except ImportError:
        element = ufl.VectorElement("Lagrange", kind, 1)
    return {"e": element} if "e" in inspect.signature(create_mesh).parameters else {"domain": ufl.Mesh(element)}


def _distributed(io: Any, mesh: Any, edges: IntArray, tags: Any) -> tuple[Any, Any]:
    """The edges that this process owns, and their tags: up to 0.7 the function takes the C++ object of the mesh."""
    try:
        return tuple(io.distribute_entity_data(mesh, 1, edges, tags))
    except TypeError:
        inner = getattr(mesh, "_cpp_object", None) or mesh._mesh
        return tuple(io.distribute_entity_data(inner, 1, edges, tags))


def placed_values(function: Any, _: HasParts) -> PlacedValues | None:
    """The values at the degrees of freedom of a scalar Lagrange function of order 2 to 4, on triangles 2; or None."""
    space = function.function_space
    element, values = space.ufl_element(), np.asarray(function.x.array)
    degree = element.degree() if callable(element.degree) else element.degree
    places = np.asarray(space.tabulate_dof_coordinates())[:, :2]
    kind: Cells = "quad" if space.mesh.topology.cell_name() == "quadrilateral" else "triangle"
    if not is_known(degree, kind) or len(places) != len(values):
        return None
    return PlacedValues(places, values, degree, kind)


def nodal_values(function: Any, mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of a scalar Lagrange function of dolfinx of order 1.

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
    found = np.empty(len(values), dtype=values.dtype)
    found[numbers[vertices]] = values[dofs]
    return found.reshape(parts.node_shape)
