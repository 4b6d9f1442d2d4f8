"""Mesh files that solvers read: Gmsh, Medit, SU2, Plot3D, OpenFOAM and XDMF."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.meshes.cell_edges import Join
from equimesh.meshes.interfaces import EDGES, Contact
from equimesh.numerics.types import Array

# Rows of a text file from tables of integers.


def integer_rows(form: str, table: npt.NDArray[np.integer[Any]]) -> list[str]:
    """The rows of a ``table``, shape ``(k, c)``, each in a ``form`` with as many ``%d``.

    All rows are made by one operation: row by row takes twice as long.
    """
    if not len(table):
        return []
    return ("\n".join([form] * len(table)) % tuple(table.ravel().tolist())).split("\n")


# Names of sides for formats that take no spaces, quotes or braces in them.

# What a name may not have in OpenFOAM, SU2 and neutral map files.
NOT_IN_WORDS = re.compile(r"[^A-Za-z0-9_.:+-]")
# What it may not have between the quotes of a Gmsh file.
NOT_IN_QUOTES = re.compile(r'["\r\n]')


def words(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """A word for each name: the name itself where it is one, else with ``_`` for what a word cannot have.

    Words differ from each other and from those that are ``taken``: of equal ones the later get a number.
    """
    return _distinct(names, NOT_IN_WORDS, taken)


def labels(names: Iterable[str], taken: Iterable[str], longest: int) -> dict[str, str]:
    """See :func:`words`, for readers that take words of at most ``longest`` characters, and any case for the same."""
    return _distinct(names, NOT_IN_WORDS, taken, longest, str.lower)


def quoted(names: Iterable[str]) -> dict[str, str]:
    """See :func:`words`, for names between quotes, which may have spaces."""
    return _distinct(names, NOT_IN_QUOTES, ())


def _distinct(
    names: Iterable[str],
    refused: re.Pattern[str],
    taken: Iterable[str],
    longest: int | None = None,
    read: Callable[[str], str] = str,
) -> dict[str, str]:
    """The words, which differ as ``read`` by readers."""
    names, used, found = [*names], {read(word) for word in taken}, dict[str, str]()
    own = dict[str, str]()
    for name in names:
        if name and not refused.search(name) and name == name[:longest] and read(name) not in used:
            own.setdefault(read(name), name)
    for name in names:
        if own.get(read(name)) == name:
            found[name] = name
            continue
        word = plain = refused.sub("_", name)[:longest] or "side"
        number = 2
        while read(word) in used or read(word) in own:
            ending = f"_{number}"
            word, number = plain[: longest and longest - len(ending)] + ending, number + 1
        used.add(read(word))
        found[name] = word
    return found


# The text of a Gmsh 2.2 file: the version that nearly every reader understands.

IntArray: TypeAlias = npt.NDArray[np.integer[Any]]

DOMAIN = "domain"  # the physical group of the cells
# Gmsh's numbers of the element types, by their nodes; of edges the number of nodes is that of the second dimension.
GMSH_EDGES = {2: 1, 3: 8}
GMSH_CELLS = {3: 2, 4: 3, 6: 9, 9: 10}


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

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, each side ``(k, 2)``; numbering starts at 0. Of
    second order cells have 6 or 9 nodes, and edges 3, the last in their middle. The sides become the physical groups 1,
    2, ... of dimension 1 in their order, the cells the group ``domain`` of dimension 2 with the next number; a cell's
    elementary entity is the number of its ``subdomain``, from 1. Where a side is called ``domain``, the cells are the
    group ``cells``. The section ``$Periodic`` has the ``joins`` as Gmsh writes them; Gmsh itself keeps the section of
    such a file as an attribute of the model.

    Cell data go into ``$ElementNodeData``, the same value at all corners: Gmsh shows them, and readers that know no
    such section skip it. (meshio refuses a file with ``$ElementData`` as soon as there are edges next to the cells.)
    """
    edges = np.concatenate(list(sides.values()))
    groups = np.repeat(np.arange(1, len(sides) + 1), [len(side) for side in sides.values()])
    domain, corners = len(sides) + 1, cells.shape[1]
    named, numbers = quoted(sides), {side: number for number, side in enumerate(sides, start=1)}
    names = [f'1 {number} "{named[side]}"' for side, number in numbers.items()]
    names.append(f'2 {domain} "{"cells" if DOMAIN in named.values() else DOMAIN}"')
    number = np.arange(1, len(edges) + len(cells) + 1)
    table = np.column_stack([number[: len(edges)], groups, groups, edges + 1])
    elements = integer_rows(f"%d {GMSH_EDGES[edges.shape[1]]} 2 %d %d {' '.join(['%d'] * edges.shape[1])}", table)
    table = np.column_stack([number[len(edges) :], subdomain + 1, cells + 1])
    elements += integer_rows(f"%d {GMSH_CELLS[corners]} 2 {domain} %d {' '.join(['%d'] * corners)}", table)
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


# The text of a Medit mesh file (INRIA), as FreeFEM and Mmg read it.


def medit_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray], *, subdomain: IntArray) -> str:
    """The file's text: points, the edges of the sides with the references 1, 2, ... in their order, and the cells.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, each side ``(k, 2)``; numbering starts at 0,
    and at 1 in the file. The reference of a cell is the number of its ``subdomain``, from 1; that of a point is that of
    the last side it lies on, 0 inside.
    """
    edges = np.concatenate(list(sides.values())) + 1
    labels = np.repeat(np.arange(1, len(sides) + 1), [len(side) for side in sides.values()])
    references = np.zeros(len(points), dtype=np.int64)
    for number, side in enumerate(sides.values(), start=1):
        references[side.ravel()] = number
    places = zip(points.tolist(), references.tolist(), strict=True)
    lines = ["MeshVersionFormatted 2", "Dimension 2", "Vertices", str(len(points))]
    lines += [f"{x!r} {y!r} {reference}" for (x, y), reference in places]
    lines += ["Edges", str(len(edges)), *_medit_rows(edges, labels)]
    lines += ["Triangles" if cells.shape[1] == 3 else "Quadrilaterals", str(len(cells))]
    lines += [*_medit_rows(cells + 1, subdomain + 1), "End"]
    return "\n".join(lines) + "\n"


def _medit_rows(nodes: IntArray, references: IntArray) -> list[str]:
    return [" ".join(map(str, row)) for row in np.column_stack([nodes, references]).tolist()]


# The text of an SU2 mesh file.

SU2_LINE, SU2_TRIANGLE, SU2_QUADRILATERAL = 3, 5, 9  # VTK's numbers of the element types, which SU2 uses


def su2_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray]) -> str:
    """The file's text: the cells, the points, and a marker with the edges of each side.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, counter-clockwise as SU2 needs them, each side
    ``(k, 2)``; numbering starts at 0, as in the file. Names of sides get ``_`` for spaces, which SU2 does not read.
    """
    shape = SU2_TRIANGLE if cells.shape[1] == 3 else SU2_QUADRILATERAL
    lines = ["NDIME= 2", f"NELEM= {len(cells)}", *_elements(shape, cells), f"NPOIN= {len(points)}"]
    lines += [f"{x!r} {y!r} {number}" for number, (x, y) in enumerate(points.tolist())]
    lines.append(f"NMARK= {len(sides)}")
    named = words(sides)
    for name, edges in sides.items():
        lines += [f"MARKER_TAG= {named[name]}", f"MARKER_ELEMS= {len(edges)}"]
        lines += [f"{SU2_LINE} {a} {b}" for a, b in edges.tolist()]
    return "\n".join(lines) + "\n"


def _elements(shape: int, cells: IntArray) -> list[str]:
    rows = enumerate(cells.tolist())
    return [f"{shape} {' '.join(map(str, nodes))} {number}" for number, nodes in rows]


# The text of a Plot3D grid of several blocks, and of the neutral map file that says how they meet.

# Numbers of a row of the grid.
PER_ROW = 3
# The number of each edge of a block among the six faces of a neutral map file, by its place in EDGES.
FACES = dict(enumerate((3, 4, 5, 6)))
# What a neutral map file calls an interface.
INTERFACE = "ONE_TO_ONE"


def plot3d_text(blocks: Sequence[tuple[Array, Array]]) -> str:
    """The grid: the number of blocks, their numbers of nodes, then x, y and z = 0 of each block.

    ``blocks`` are x and y of each, shape ``(n_i, n_j)``; in the file i runs fastest, and each block has one node along
    k. Numbers are written so that they are read back bit for bit.

    Source: P. Walatka et al., PLOT3D user's manual, NASA TM 101067 (1990), chapter 8: formatted, 3D, several blocks.
    """
    lines = [str(len(blocks)), *(f"{x.shape[0]} {x.shape[1]} 1" for x, _ in blocks)]
    for x, y in blocks:
        for values in (x, y, np.zeros(x.shape)):
            lines.extend(_plot3d_rows([*map(repr, values.T.ravel().tolist())]))
    return "\n".join(lines) + "\n"


def neutral_map(shapes: Sequence[tuple[int, int]], contacts: Sequence[Contact]) -> str:
    """The neutral map file: blocks with their numbers of nodes, interfaces, and edges on sides by the side's name.

    Each line has a block, the number of its face (3 least i, 4 largest i, 5 least j, 6 largest j), and the ranges of
    nodes on it: j and k on the first two faces, k and i on the others. Numbers begin at 1, and k is 1 everywhere. An
    interface goes on with the same of the other block, and TRUE where j of one runs along i of the other.

    Source: NASA Geometry Laboratory, "Neutral Map File Format".
    """
    named = words([contact.side for contact in contacts if contact.side is not None])
    lines = ["# blocks", str(len(shapes)), *(f"{k} {i} {j} 1" for k, (i, j) in enumerate(shapes, start=1))]
    lines.append("# type, block, face, two ranges of nodes; of an interface those of the other block, axes swapped")
    for contact in contacts:
        here = f"{contact.block + 1} {_face(contact.edge, contact.first, contact.last)}"
        if contact.side is not None:
            lines.append(f"'{named[contact.side]}' {here}")
            continue
        there = f"{contact.other + 1} {_face(contact.other_edge, contact.other_first, contact.other_last)}"
        is_swapped = (contact.edge < 2) != (contact.other_edge < 2)
        lines.append(f"'{INTERFACE}' {here} {there} {str(is_swapped).upper()}")
    return "\n".join(lines) + "\n"


def _face(edge: int, first: int, last: int) -> str:
    along, across = f"{first + 1} {last + 1}", "1 1"
    ranges = (along, across) if EDGES[edge].startswith("i") else (across, along)
    return f"{FACES[edge]} {' '.join(ranges)}"


def _plot3d_rows(numbers: list[str]) -> Iterator[str]:
    return (" ".join(numbers[k : k + PER_ROW]) for k in range(0, len(numbers), PER_ROW))


# The files of an OpenFOAM mesh, ``constant/polyMesh``: the plane mesh, one cell thick along z.

# Where OpenFOAM looks for a mesh, below the folder of a case.
FOLDER = "constant/polyMesh"
# The patch of all faces below and above the plane. OpenFOAM solves nothing along z where its type is "empty".
PLANE_PATCH = "frontAndBack"


@dataclass(frozen=True, eq=False)
class Faces:
    """The edges of plane cells, from which faces are made.

    ``edges`` of shape ``(k, 2)`` go counter-clockwise around their ``owner``. Internal ones come first, in the order
    of owner and ``neighbour``, which are the lower and the higher number of the two cells; then those of the sides.
    """

    edges: IntArray
    owner: IntArray
    neighbour: IntArray


def foam_files(
    points: Array, cells: IntArray, sides: Mapping[str, IntArray], joins: Sequence[Join] = ()
) -> dict[str, str]:
    """The texts of ``points``, ``faces``, ``owner``, ``neighbour`` and ``boundary``, by name.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, counter-clockwise, each side ``(k, 2)``, with
    the domain on its left. Cells keep their numbers. Node ``i`` is a point of the plane z = 0, and ``i + n`` the point
    above it, at the mean size of a cell. Each side is a patch, with its faces in the order of its edges; the patch
    ``frontAndBack`` is of the type ``empty``. The two sides of a join are patches of the type ``cyclic``, the faces of
    the copy in the order of their originals. Names of sides get ``_`` for what OpenFOAM does not take in a word.

    Source: OpenFOAM user guide, "Mesh description": a face is internal or of one patch, its normal leaves the owner.
    """
    copies = {join.copy: join.edges for join in joins}
    sides = {name: copies[name][:, ::-1] if name in copies else edges for name, edges in sides.items()}
    count, faces = len(points), plane_faces(cells, sides)
    inner, total = len(faces.neighbour), len(faces.edges) + 2 * len(cells)
    note = f"nPoints:{2 * count}  nCells:{len(cells)}  nFaces:{total}  nInternalFaces:{inner}"
    edges = faces.edges
    walls = np.column_stack([edges, edges[:, ::-1] + count])
    if copies:  # a face and its copy begin at the same corner, and go around it in opposite directions
        is_copy = np.zeros(len(edges), dtype=bool)
        is_copy[inner:] = np.repeat([name in copies for name in sides], [len(side) for side in sides.values()])
        walls[is_copy] = np.roll(walls[is_copy], -1, axis=1)
    plane = np.concatenate([cells[:, ::-1], cells + count])
    owner = np.concatenate([faces.owner, np.tile(np.arange(len(cells)), 2)])
    height = float(np.sqrt(_area(points, cells) / len(cells)))
    in_plane = [f"({x!r} {y!r} " for x, y in points.tolist()]
    places = [f"{place}{z!r})" for z in (0.0, height) for place in in_plane]
    return {
        "points": _file("vectorField", "points", places),
        "faces": _file("faceList", "faces", [*_faces_text(walls), *_faces_text(plane)]),
        "owner": _file("labelList", "owner", map(str, owner.tolist()), note),
        "neighbour": _file("labelList", "neighbour", map(str, faces.neighbour.tolist()), note),
        "boundary": _boundary(sides, inner, 2 * len(cells), joins),
    }


def plane_faces(cells: IntArray, sides: Mapping[str, IntArray]) -> Faces:
    """The edges of the cells in OpenFOAM's order: internal ones, then each side in the order of its edges.

    Every edge must be of two cells, or of one cell and one side.
    """
    around = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2)
    of_cell = np.repeat(np.arange(len(cells)), cells.shape[1])
    keys = _keys(around, cells)
    order = np.argsort(keys, kind="stable")  # of two equal edges, that of the lower cell first
    pairs = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    first, second = order[pairs], order[pairs + 1]
    first = first[by := np.lexsort((of_cell[second], of_cell[first]))]
    second = second[by]
    boundary = np.concatenate(list(sides.values()))
    places = order[np.searchsorted(keys[order], _keys(boundary, cells))]
    return Faces(
        edges=np.concatenate([around[first], boundary]),
        owner=np.concatenate([of_cell[first], of_cell[places]]),
        neighbour=of_cell[second],
    )


def _keys(edges: IntArray, cells: IntArray) -> IntArray:
    """One number for every edge, the same in both directions."""
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys: IntArray = low * (int(cells.max()) + 1) + high
    return keys


def _area(points: Array, cells: IntArray) -> float:
    x, y = points[cells, 0], points[cells, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)))


def _faces_text(faces: IntArray) -> list[str]:
    corners = faces.shape[1]
    return integer_rows(f"{corners}({' '.join(['%d'] * corners)})", faces)


def _boundary(sides: Mapping[str, IntArray], inner: int, plane: int, joins: Sequence[Join]) -> str:
    patches, start, named = [], inner, words(sides, taken=[PLANE_PATCH])
    cyclic = {join.original: _cyclic(named[join.copy], join.translation) for join in joins}
    cyclic |= {join.copy: _cyclic(named[join.original], -join.translation) for join in joins}
    of_sides = [(named[side], cyclic.get(side, "    type patch;"), len(edges)) for side, edges in sides.items()]
    for name, kind, count in [*of_sides, (PLANE_PATCH, "    type empty;", plane)]:
        patches.append(f"{name}\n{{\n{kind}\n    nFaces {count};\n    startFace {start};\n}}")
        start += count
    return _file("polyBoundaryMesh", "boundary", patches)


def _cyclic(other: str, way: Array) -> str:
    """The entries of a cyclic patch; ``way`` leads from it to the ``other`` one."""
    dx, dy = way.tolist()
    rows = ["type cyclic", f"neighbourPatch {other}", "transform translational", f"separationVector ({dx!r} {dy!r} 0)"]
    return "\n".join(f"    {row};" for row in rows)


def _file(kind: str, name: str, rows: Any, note: str | None = None) -> str:
    """A list with the head that OpenFOAM expects."""
    entries = [*rows]
    lines = ["FoamFile", "{", "    version 2.0;", "    format ascii;", f"    class {kind};"]
    lines += [] if note is None else [f'    note "{note}";']
    lines += [f'    location "{FOLDER}";', f"    object {name};", "}"]
    return "\n".join([*lines, str(len(entries)), "(", *entries, ")"]) + "\n"


# How meshio begins and ends the grid of a file.
GRID, END = '<Grid Name="Grid">', "</Grid>"
# The text of an Information must be XML for meshio; this one says nothing.
NOTHING = "&lt;nothing/&gt;"


def with_time(text: str) -> str:
    """The same file with the time 0, readable by programs that know no time.

    meshio reads no grid with an element ``Time``, and skips what is inside an ``Information``. So a second grid with
    the time stands there, and the first one refers to it: readers that follow a ``Reference``, such as VTK's and with
    it PyVista's, take the second; dolfinx, meshio and the newer reader of ParaView take the first. Both point to the
    same arrays of the HDF5 file.

    Raises ``ValueError`` for a text that is not one grid.
    """
    head, grid, rest = text.partition(GRID)
    content, end, tail = rest.partition(END)
    if not grid or not end:
        raise ValueError("the text holds no grid")
    timed = f'{GRID}<Time Value="0"/>{content}{END}'
    reference = '<Grid Name="Grid" Reference="/Xdmf/Domain/Grid/Information/Grid">'
    return f'{head}{reference}{content}<Information Name="time" Value="0">{NOTHING}{timed}</Information>{END}{tail}'
