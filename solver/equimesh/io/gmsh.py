"""The text of a Gmsh 2.2 file: the version that nearly every reader understands."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.io.integer_rows import integer_rows
from equimesh.io.side_names import quoted
from equimesh.meshes.joins import Join
from equimesh.numerics.types import Array

IntArray: TypeAlias = npt.NDArray[np.integer[Any]]

DOMAIN = "domain"  # the physical group of the cells
LINE, TRIANGLE, QUADRILATERAL = 1, 2, 3  # Gmsh's numbers of the element types


def gmsh_text(
    points: Array,
    cells: IntArray,
    sides: Mapping[str, IntArray],
    *,
    subdomain: IntArray,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, npt.NDArray[Any]],
    joins: Sequence[Join] = (),
) -> str:
    """The file's text: first the edges of each side, then the cells.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, each side ``(k, 2)``; numbering starts at 0.
    The sides become the physical groups 1, 2, ... of dimension 1 in their order, the cells the group ``domain`` of
    dimension 2 with the next number; a cell's elementary entity is the number of its ``subdomain``, from 1. Where a
    side is called ``domain``, the cells are the group ``cells``. The section ``$Periodic`` has the ``joins``
    as Gmsh writes them; Gmsh itself keeps the section of such a file as an attribute of the model.

    Cell data go into ``$ElementNodeData``, the same value at all corners: Gmsh shows them, and readers that know no
    such section skip it. (meshio refuses a file with ``$ElementData`` as soon as there are edges next to the cells.)
    """
    edges = np.concatenate(list(sides.values()))
    groups = np.repeat(np.arange(1, len(sides) + 1), [len(side) for side in sides.values()])
    domain, corners = len(sides) + 1, cells.shape[1]
    shape = TRIANGLE if corners == 3 else QUADRILATERAL
    named, numbers = quoted(sides), {side: number for number, side in enumerate(sides, start=1)}
    names = [f'1 {number} "{named[side]}"' for side, number in numbers.items()]
    names.append(f'2 {domain} "{"cells" if DOMAIN in named.values() else DOMAIN}"')
    number = np.arange(1, len(edges) + len(cells) + 1)
    table = np.column_stack([number[: len(edges)], groups, groups, edges + 1])
    elements = integer_rows(f"%d {LINE} 2 %d %d %d %d", table)
    table = np.column_stack([number[len(edges) :], subdomain + 1, cells + 1])
    elements += integer_rows(f"%d {shape} 2 {domain} %d {' '.join(['%d'] * corners)}", table)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    lines += ["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]
    lines += ["$Nodes", str(len(points)), *_numbered(f"{x!r} {y!r} 0.0" for x, y in points.tolist()), "$EndNodes"]
    lines += ["$Elements", str(len(elements)), *elements, "$EndElements"]
    lines += _periodic(sides, joins, numbers)
    for name, values in point_data.items():
        lines += _data("NodeData", name, _texts(values), values)
    for name, values in cell_data.items():
        rows = (f"{corners}" + f" {value}" * corners for value in _texts(values))
        lines += _data("ElementNodeData", name, rows, values, start=len(edges) + 1)
    return "\n".join(lines) + "\n"


def _periodic(sides: Mapping[str, IntArray], joins: Sequence[Join], numbers: Mapping[str, int]) -> list[str]:
    """The section ``$Periodic``: for each join its two lines, and the nodes of the copy with their originals."""
    if not joins:
        return []
    lines = ["$Periodic", str(len(joins))]
    for join in joins:
        pairs = np.unique(np.column_stack([join.edges.ravel(), sides[join.original].ravel()]), axis=0) + 1
        lines.append(f"1 {numbers[join.copy]} {numbers[join.original]}")
        dx, dy = join.translation.tolist()
        lines.append(f"Affine 1 0 0 {dx!r} 0 1 0 {dy!r} 0 0 1 0 0 0 0 1")
        lines += [str(len(pairs)), *(f"{copy} {original}" for copy, original in pairs.tolist())]
    return [*lines, "$EndPeriodic"]


def _numbered(rows: Iterable[str], start: int = 1) -> Iterator[str]:
    return (f"{k} {row}" for k, row in enumerate(rows, start=start))


def _texts(values: npt.NDArray[Any]) -> Iterator[str]:
    """The number of each row, or the three numbers of a vector."""
    rows = values.astype(np.float64).tolist()
    return (" ".join(map(repr, row)) if isinstance(row, list) else repr(row) for row in rows)


def _data(section: str, name: str, rows: Iterable[str], values: npt.NDArray[Any], start: int = 1) -> list[str]:
    """One field: its name, the time 0, then time step, components (1 or 3) and entries."""
    components = "1" if values.ndim == 1 else str(values.shape[1])
    head = [f"${section}", "1", f'"{name}"', "1", "0.0", "3", "0", components, str(len(values))]
    return [*head, *_numbered(rows, start), f"$End{section}"]
