"""scikit-fem: a ``MeshQuad`` or ``MeshTri``, and vectors of nodal degrees of freedom."""

from __future__ import annotations

from typing import Any, Final

from equimesh_coupling.arrays import real
from equimesh_coupling.elements import PlacedValues
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, Cells, HasParts, MeshParts
from equimesh_coupling.recovery import edge_numbers

OLDEST: Final = "9"
INSTALL: Final = f"pip install 'scikit-fem>={OLDEST}'"
# The elements of degree 2, and their cells.
QUADRATIC: Final[dict[str, Cells]] = {"ElementQuad2": "quad", "ElementTriP2": "triangle"}


def mesh_of(parts: MeshParts) -> Any:
    """The mesh of scikit-fem, with the sides as ``boundaries``; node ``k`` is vertex ``k``."""
    skfem = library("skfem", package="scikit-fem", at_least=OLDEST, install=INSTALL)
    kind = skfem.MeshTri if parts.is_triangular else skfem.MeshQuad
    mesh = kind(parts.points.T.copy(), parts.cells.T.copy())
    facets = {side: edge_numbers(edges, mesh.facets.T) for side, edges in parts.sides.items()}
    return mesh.with_boundaries(facets)


def placed_values(field: tuple[Any, Any], _: HasParts) -> PlacedValues | None:
    """The values at the degrees of freedom of ``ElementQuad2`` or ``ElementTriP2``; ``None`` for another element."""
    basis = field[0]
    cells = QUADRATIC.get(type(basis.elem).__name__)
    if cells is None:
        return None
    vector = real(field[1], "the vector of scikit-fem")
    _check_length(basis, vector)
    return PlacedValues(basis.doflocs.T, vector, cells=cells)


def nodal_values(field: tuple[Any, Any], mesh: HasParts) -> Array:
    """The values at the nodes, in the ``node_shape`` of the mesh, of ``(basis, vector)`` as scikit-fem solves for it.

    The element of the basis needs a degree of freedom at each vertex: ``ElementQuad1``, ``ElementTri2`` and so on.
    Raises :class:`BadValues` for another element, mesh or length.
    """
    parts = mesh.mesh_parts()
    basis, vector = field[0], real(field[1], "the vector of scikit-fem")
    at_vertices = basis.nodal_dofs
    if at_vertices.shape != (1, len(parts.points)):
        raise BadValues(
            f"the basis of scikit-fem has {at_vertices.shape[0]} values at each of {at_vertices.shape[1]} vertices, "
            f"and needs 1 at each of {len(parts.points)}: take a scalar Lagrange element on this mesh"
        )
    _check_length(basis, vector)
    values: Array = vector[at_vertices[0]].reshape(parts.node_shape)
    return values


def _check_length(basis: Any, vector: Array) -> None:
    """Raise :class:`BadValues` for a vector of another basis."""
    if len(vector) != basis.N:
        raise BadValues(
            f"the vector of scikit-fem has {len(vector)} entries, and its basis {basis.N} degrees of freedom: return "
            "the basis on which it was solved for"
        )
