"""What a solver returned, as checked values at the nodes of the mesh that it was given."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, TypeVar

from equimesh_coupling.adaptors import dmplex, dolfinx, fipy, mfem, ngsolve, pyvista, sfepy, skfem
from equimesh_coupling.arrays import finite, real
from equimesh_coupling.elements import WORDS, PlacedValues, at_elements, element_shape
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, Cells, HasParts
from equimesh_coupling.recovery import CellAverages, ErrorIndicator, cell_counts, cell_values, nodes_from_cells

__all__ = [
    "CellAverages",
    "ElementValues",
    "ErrorIndicator",
    "cell_values",
    "element_values",
    "is_field",
    "node_values",
]

Read = TypeVar("Read")

# By the package and the class of a field, or of a class that it is derived from: the adaptor that reads it.
READERS: Final[dict[tuple[str, str], Callable[[Any, HasParts], Array]]] = {
    ("dolfinx", "Function"): dolfinx.nodal_values,
    ("fipy", "CellVariable"): fipy.nodal_values,
    ("mfem", "GridFunction"): mfem.nodal_values,
    ("ngsolve", "GridFunction"): ngsolve.nodal_values,
    ("pyvista", "UnstructuredGrid"): pyvista.nodal_values,
    ("sfepy", "FieldVariable"): sfepy.nodal_values,
}


# By the package and the class of a field: the adaptor that reads its values at its own places, if it sees the degree.
PLACES: Final[dict[tuple[str, str], Callable[[Any, HasParts], PlacedValues | None]]] = {
    ("dolfinx", "Function"): dolfinx.placed_values,
    ("mfem", "GridFunction"): mfem.placed_values,
    ("ngsolve", "GridFunction"): ngsolve.placed_values,
    ("sfepy", "FieldVariable"): sfepy.placed_values,
}


class ElementValues(NamedTuple):
    """The values at the nodes of elements of a ``degree`` on ``cells``, in their ``element_shape``."""

    values: Array
    degree: int
    cells: Cells = "quad"


def element_values(
    returned: Any, mesh: HasParts, degree: int | None = None, cells: Cells | None = None
) -> ElementValues:
    """The values at the nodes of elements on ``mesh``, from what a solver ``returned``.

    Without a ``degree`` and ``cells`` they are those of the space of a field, where it is one of scalar Lagrange
    elements of degree 2 and more, else 1 and quadrilaterals.

    Raises :class:`BadValues` as :func:`node_values`, and where there is not one value for each node of elements of the
    ``degree``.
    """
    known: Cells = cells or "quad"
    if isinstance(returned, CellAverages | ErrorIndicator) or degree == 1:
        if degree is not None and degree > 1:
            raise BadValues(f"values of cells say nothing of elements of degree {degree}: return values at their nodes")
        return ElementValues(node_values(returned, mesh), 1, known)
    read = _placed(returned)
    placed = None if read is None else read(returned, mesh)
    if placed is not None:
        if degree is not None and degree != placed.degree:
            raise BadValues(f"the space of this field has degree {placed.degree}, and degree = {degree} is given")
        if cells is not None and cells != placed.cells:
            raise BadValues(f"the space of this field is one on {WORDS[placed.cells]}, and cells = {cells!r} is given")
        what = "the solution"
        return ElementValues(finite(real(at_elements(placed, mesh), what), what), placed.degree, placed.cells)
    if degree is None:
        return ElementValues(node_values(returned, mesh), 1, known)
    order, of_cells = f"element_points(mesh, {degree})", ""
    if known == "triangle":
        order, of_cells = f'element_points(mesh, {degree}, "triangle")', " on triangles"
    if is_field(returned):
        raise BadValues(
            f"the space of this field is none whose degree {degree} can be seen: return a field of a scalar Lagrange"
            f" space of this degree on the {WORDS[known]} of this mesh, or its values at {order}"
        )
    values, shape = finite(real(returned, "the solution"), "the solution"), element_shape(mesh, degree)
    if values.shape != shape and not (values.size == math.prod(shape) and max(values.shape) == values.size):
        raise BadValues(
            f"the solution has the shape {values.shape}, and elements of degree {degree}{of_cells} have"
            f" {math.prod(shape)} nodes on this mesh: return an array of shape {shape}, or flat in the order of {order}"
        )
    return ElementValues(values.reshape(shape), degree, known)


def _placed(returned: Any) -> Callable[[Any, HasParts], PlacedValues | None] | None:
    """The adaptor that reads values at their own places, found as those of the readers."""
    return skfem.placed_values if _is_pair_of("skfem", returned) else _adaptor(PLACES, returned)


def node_values(returned: Any, mesh: HasParts, what: str = "the solution") -> Array:
    """The values at the nodes of ``mesh``, shape ``(n_xi, n_eta)``, from what a solver ``returned`` as ``what``.

    It takes an array with one value for each node, of shape ``(n_xi, n_eta)`` or flat in the order of the nodes; a
    field of FEniCSx, FiPy, MFEM, NGSolve, PyVista or SfePy; ``(basis, vector)`` of scikit-fem; ``(plex, vector)`` of
    PETSc; and :class:`CellAverages`, from which the values at the nodes are recovered.

    Raises :class:`BadValues` for another length, for values that are not finite, for an error indicator, and for an
    array with one value for each cell.
    """
    parts = mesh.mesh_parts()
    if isinstance(returned, CellAverages):
        return nodes_from_cells(returned, mesh)
    if isinstance(returned, ErrorIndicator):
        raise BadValues("an error indicator is no solution: return values at the nodes")
    read = _reader(returned)
    if read is not None:
        return finite(real(read(returned, mesh), what), what)
    values = real(returned, what)
    if values.shape == parts.node_shape:
        return finite(values, what)
    if values.size == len(parts.points) and max(values.shape) == values.size:
        return finite(values.reshape(parts.node_shape), what)
    if values.size in cell_counts(parts):
        raise BadValues(
            f"{what} has {values.size} values, one for each cell, and needs one for each of the "
            f"{len(parts.points)} nodes: wrap averages over cells in CellAverages(values), an error indicator in "
            "ErrorIndicator(values)"
        )
    raise BadValues(
        f"{what} has the shape {values.shape}, and needs one value for each of the {len(parts.points)} nodes: "
        f"return an array of shape {parts.node_shape}, or flat in the order of the nodes"
    )


def is_field(returned: Any) -> bool:
    """Whether this is a field of another library, which :func:`node_values` reads by an adaptor."""
    return _reader(returned) is not None


def _reader(returned: Any) -> Callable[[Any, HasParts], Array] | None:
    """The adaptor for a field of another library, found by the names of its types: no library is imported."""
    if _is_pair_of("skfem", returned):
        return skfem.nodal_values
    return dmplex.nodal_values if _is_pair_of("petsc4py", returned) else _adaptor(READERS, returned)


def _adaptor(adaptors: Mapping[tuple[str, str], Read], returned: Any) -> Read | None:
    """That one of the ``adaptors`` which reads the class of a field, or a class that it is derived from."""
    names = ((kind.__module__.partition(".")[0], kind.__name__) for kind in type(returned).__mro__)
    return next((adaptors[name] for name in names if name in adaptors), None)


def _is_pair_of(package: str, returned: Any) -> bool:
    return isinstance(returned, tuple) and len(returned) == 2 and _is_of(package, returned[0])


def _is_of(package: str, value: Any) -> bool:
    return any(kind.__module__.partition(".")[0] == package for kind in type(value).__mro__)
