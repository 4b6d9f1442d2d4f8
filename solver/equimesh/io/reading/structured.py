"""Meshes from files of structured grids: Plot3D and CGNS."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.errors import InputError
from equimesh.io.reading.bounds import bad_file, floats
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.numerics.types import Array, IntArray

if TYPE_CHECKING:
    import h5py

# Meshes from Plot3D files of one or several blocks, as text or binary.

# Nodes on the rims of blocks are one node where they are nearer than this part of the size of the mesh.
SAME_PLACE: Final = 1e-10
# What a text may have.
_PRINTED: Final = bytes(range(32, 127)) + b"\t\r\n"
# The faces of a neutral map file at the least and largest i, and at the least and largest j.
FACES: Final = (3, 4, 5, 6)
# Those of them that have a right-handed block on the left where their index rises.
LEFT_WHEN_RISING: Final = (4, 5)
# What a neutral map file calls an interface of blocks.
INTERFACE: Final = "ONE_TO_ONE"
# The first character of a name in a row of a map, and the numbers behind it; words have one space between them.
_NAME = re.compile(r"[^\s\d]")
_RANGES = re.compile(r"'?((?: -?\d+){6})(?: -?\d|$)")
# Blocks of a file, and nodes of a block along a direction, at most.
MAX_BLOCKS, MAX_NODES = 100_000, 10_000_000
# Fortran's repetitions such as ``3*0.5``, ...
_REPETITION = re.compile(rb"(?<!\S)(\d{1,19}+)\*(\S++)")
# ... how many a file may have, and the numbers that they stand for, at most: one for each byte of the file, and more.
MAX_REPETITIONS: Final = 1_000_000
MORE_REPEATED: Final = 100_000
# Records of a file, at most.
MAX_RECORDS = 200_000


@dataclass(frozen=True)
class _Head:
    """One reading of the first ``length`` numbers of a file: how many nodes each block has, and coordinates of each."""

    shapes: tuple[tuple[int, int], ...]
    dimension: int
    length: int

    @property
    def nodes(self) -> int:
        """The nodes of all blocks."""
        return sum(i * j for i, j in self.shapes)


def read_plot3d(data: bytes, neutral_map: bytes | None = None) -> PlainMesh:
    """The mesh of a Plot3D file: 2D, or 3D with one layer of nodes; one or several blocks, with or without iblank.

    Numbers may be text, or binary with or without the marks of Fortran's records, with 4 or 8 bytes in either order.
    Nodes of blocks at the same place become one node. A block closed on itself is joined in the same way. The names
    of the sides come from a ``neutral_map`` file; without it the mesh has none. Raises
    :class:`~equimesh.errors.InputError` for a broken file, with the line of the map.

    Sources: P. Walatka et al., PLOT3D user's manual, NASA TM 101067 (1990), chapter 8; NASA Geometry Laboratory,
    "Neutral Map File Format".
    """
    blocks = [
        np.ascontiguousarray(values.reshape(head.dimension, n_j, n_i).transpose(2, 1, 0))
        for head, found in (_text(data) if _is_text(data) else _binary(data),)
        for (n_i, n_j), values in zip(head.shapes, found, strict=True)
    ]
    return joined(blocks, sides_of_map(neutral_map, blocks) if neutral_map is not None else {})


def joined(blocks: list[Array], sides: dict[str, list[tuple[int, IntArray]]]) -> PlainMesh:
    """One mesh of ``blocks`` of coordinates, shape ``(n_i, n_j, 2 or 3)``; nodes at the same place become one.

    ``sides`` are lists of the number of a block and of edges, shape ``(k, 2)``, of its nodes ``i * n_j + j``.
    """
    points = np.concatenate([block.reshape(-1, block.shape[2]) for block in blocks])
    starts = np.concatenate([[0], np.cumsum([block.shape[0] * block.shape[1] for block in blocks])])
    numbers = [np.arange(start, start + b.shape[0] * b.shape[1]).reshape(b.shape[:2]) for start, b in
               zip(starts, blocks, strict=False)]  # fmt: skip
    rim = np.concatenate([np.concatenate([n[0], n[-1], n[1:-1, 0], n[1:-1, -1]]) for n in numbers])
    if not np.isfinite(points).all():
        node = int((~np.isfinite(points).all(axis=1)).argmax())
        block = int(np.searchsorted(starts, node, side="right")) - 1
        raise bad_file(f"block {block} of the file has the coordinates {points[node].tolist()}")
    new = _merged(points, rim)
    first = np.unique(new, return_index=True)[1]
    cells = np.concatenate(
        [np.stack([n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]], axis=-1).reshape(-1, 4) for n in numbers]
    )
    edges = {
        name: np.concatenate([new[starts[block] + table] for block, table in tables]) for name, tables in sides.items()
    }
    return PlainMesh.of(points[first], new[cells], edges)


def sides_of_map(data: bytes, blocks: list[Array]) -> dict[str, list[tuple[int, IntArray]]]:
    """The sides that a neutral map file names, for :func:`joined`; interfaces are left out, the places tell them.

    A line has a name, the number of a block and of its face, and two ranges of nodes, of which one is 1 to 1.
    """
    sides: dict[str, list[tuple[int, IntArray]]] = {}
    left = sum(2 * sum(block.shape[:2]) for block in blocks)  # edges that may have a side yet
    for number, row in enumerate(data.decode("utf-8", "replace").splitlines(), start=1):
        name, words = _map_row(row)
        if not name or name.upper() == INTERFACE:
            continue
        block, face, *ends = (int(word) for word in words)
        first, last = ends[:2] if ends[0] != ends[1] else ends[2:]
        if not 1 <= block <= len(blocks) or face not in FACES:
            raise bad_file(f"line {number} of the map: there is no face {face} of a block {block}")
        n_i, n_j = blocks[block - 1].shape[:2]
        most = n_j if face in FACES[:2] else n_i
        if not (min(first, last) >= 1 and max(first, last) <= most):
            raise bad_file(f"line {number} of the map: nodes {first} to {last}, but the face has {most}")
        along = np.arange(min(first, last) - 1, max(first, last))
        left -= len(along) - 1
        if left < 0:
            raise bad_file(
                f"line {number} of the map: the sides have more edges than the blocks: give each face one side"
            )
        at = {
            FACES[0]: along,
            FACES[1]: (n_i - 1) * n_j + along,
            FACES[2]: along * n_j,
            FACES[3]: along * n_j + n_j - 1,
        }
        line = at[face] if face in LEFT_WHEN_RISING else at[face][::-1]  # the block on the left
        sides.setdefault(name, []).append((block - 1, np.column_stack([line[:-1], line[1:]])))
    return sides


def _map_row(row: str) -> tuple[str, list[str]]:
    """The name in a row of a neutral map, and the six numbers behind it; an empty name for rows of another form."""
    row = " ".join(row.partition("#")[0].split())
    start = _NAME.search(row)
    found = None if start is None else _RANGES.search(row, start.end())
    if found is None:
        return "", []
    name = row[: found.start()].removeprefix("'").strip()
    return ("", []) if "'" in name else (name, found[1].split())


def _merged(points: Array, rim: IntArray) -> IntArray:
    """A number for each point, the same at the same place, in the order in which they first occur."""
    one, other = _at_same_place(points[rim], SAME_PLACE * float(np.ptp(points, axis=0).max()))
    graph = scipy.sparse.coo_array((np.ones(len(one)), (rim[one], rim[other])), shape=(len(points), len(points)))
    group = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    first = np.full(int(group.max()) + 1, len(points))
    np.minimum.at(first, group, np.arange(len(points)))
    number = np.empty(len(first), np.int64)
    number[np.argsort(first)] = np.arange(len(first))
    found: IntArray = number[group]
    return found


def _at_same_place(places: Array, near: float) -> tuple[IntArray, IntArray]:
    """Pairs that connect all ``places`` nearer than ``near``, and none that are three times as far from each other.

    Their number is about that of the places, however many are at one place: all of a small square are paired with its
    first one, and the first ones of squares with each other.
    """
    if not 0.0 < near < np.inf:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    squares = np.floor((places - places.min(axis=0)) / (0.5 * near)).astype(np.int64)
    firsts, square = np.unique(squares, axis=0, return_index=True, return_inverse=True)[1:]
    pairs = scipy.spatial.KDTree(places[firsts]).query_pairs(3.0 * near, output_type="ndarray")
    return (
        np.concatenate([np.arange(len(places)), firsts[pairs[:, 0]]]),
        np.concatenate([firsts[square.reshape(-1)], firsts[pairs[:, 1]]]),
    )


def _is_text(data: bytes) -> bool:
    return not data[:4096].translate(None, _PRINTED)


def _text(data: bytes) -> tuple[_Head, list[Array]]:
    """The head of a text, and the coordinates of each block."""
    text = data.replace(b",", b" ").replace(b"D", b"e").replace(b"d", b"e")
    if b"*" in text:
        most = len(data) + MORE_REPEATED
        if text.count(b"*") > MAX_REPETITIONS:
            raise bad_file(f"more than {MAX_REPETITIONS} repetitions: write them out, or a binary file")
        if sum(int(found[1]) for found in _REPETITION.finditer(text)) > most:
            raise bad_file(f"repetitions stand for more than {most} numbers: write them out, or a binary file")
        text = _REPETITION.sub(lambda found: (found[2] + b" ") * int(found[1]), text)
    flat = floats(text, 1, "the coordinates")
    for head in _heads(flat):
        for blanked in (0, 1):
            if head.length + head.nodes * (head.dimension + blanked) == len(flat):
                return head, _cut(flat, head, head.length, blanked)
    raise _no_plot3d()


def _cut(flat: Array, head: _Head, at: int, blanked: int) -> list[Array]:
    """The coordinates of each block, which begin at number ``at``; ``blanked`` more numbers of each node are left."""
    found = []
    for i, j in head.shapes:
        found.append(flat[at : at + head.dimension * i * j])
        at += (head.dimension + blanked) * i * j
    return found


def _heads(numbers: npt.NDArray[Any]) -> Iterator[_Head]:
    """What the first numbers may mean: plane blocks or blocks of one layer, several or one."""
    for dimension, several in ((2, True), (2, False), (3, True), (3, False)):
        blocks, start = 1, int(several)
        if several:
            blocks = int(numbers[0]) if len(numbers) and 1 <= numbers[0] <= MAX_BLOCKS else 0
        length = start + dimension * blocks
        if not blocks or length > len(numbers):
            continue
        rows = numbers[start:length].reshape(blocks, dimension)
        good = (rows >= 1) & (rows <= MAX_NODES) & (rows == np.floor(rows))
        if good.all() and (rows[:, :2] >= 2).all() and (dimension == 2 or (rows[:, 2] == 1).all()):
            yield _Head(tuple((int(row[0]), int(row[1])) for row in rows), dimension, length)


def _binary(data: bytes) -> tuple[_Head, list[Array]]:
    """The head of a binary file, and the coordinates of each block; iblank has 4 bytes a node."""
    for order in ("<", ">"):
        body = b"".join(_records(data, order)) or data
        for head in _heads(np.frombuffer(body[: len(body) // 4 * 4], f"{order}i4")):
            for size, blanked in ((8, 0), (8, 1), (4, 0), (4, 1)):
                if 4 * head.length + head.nodes * (head.dimension * size + 4 * blanked) != len(body):
                    continue
                found, at = [], 4 * head.length
                for i, j in head.shapes:
                    count = head.dimension * i * j
                    found.append(np.frombuffer(body, f"{order}f{size}", count, at).astype(np.float64))
                    at += count * size + 4 * blanked * i * j
                return head, found
    raise _no_plot3d()


def _no_plot3d() -> InputError:
    message = (
        "the file is no Plot3D grid of plane blocks: the numbers of nodes at its begin do not fit the coordinates"
        " behind them; 3D blocks must have one node in the third direction"
    )
    return bad_file(message)


def _records(data: bytes, order: str) -> list[bytes]:
    """Fortran's records without their marks; none where the file has no such marks."""
    found: list[bytes] = []
    at, mark = 0, np.dtype(f"{order}u4")
    while at + 8 <= len(data) and len(found) < MAX_RECORDS:
        size = int(np.frombuffer(data, mark, 1, at)[0])
        end = at + 4 + size
        if not size or end + 4 > len(data) or int(np.frombuffer(data, mark, 1, end)[0]) != size:
            return []
        found.append(data[at + 4 : end])
        at = end + 4
    return found if at == len(data) else []


# How the first bytes of an HDF5 file, and of the older ADF file, begin.
HDF5, ADF = b"\x89HDF", b"ADF"
# Zones of a file, and nodes of a zone along a direction, at most.
MAX_ZONES, MAX_ZONE_NODES = 10_000, 10_000_000
# Where a boundary condition lies: at nodes, ...
AT_NODES: Final = "Vertex"
# ... or on faces, whose numbers are those of cells along the side.
ON_FACES: Final = ("FaceCenter", "EdgeCenter", "IFaceCenter", "JFaceCenter")
# What a broken file raises; MemoryError: the library trusts the sizes in a broken head.
BROKEN: Final = (OSError, RuntimeError, LookupError, ValueError, TypeError, OverflowError, MemoryError)


def read_cgns(data: bytes) -> PlainMesh:
    """The mesh of a CGNS file with plane structured zones, with three axes of one layer.

    Nodes of zones at the same place become one node, as 1-to-1 connectivity has them. Zones are blocks, with their
    names. Boundary conditions with a range of points are sides: those of one family are one side with its name, others
    have their own name. Raises :class:`~equimesh.errors.InputError` for other zones, for data in other files, and for a
    broken file; the message has the zone.

    Sources: CGNS SIDS, "Zone definition" and "Boundary conditions"; CGNS file mapping manual, "HDF5".
    """
    if not data.startswith(HDF5):
        remedy = "convert it by cgnsconvert to HDF5" if ADF in data[:64] else "save it again"
        raise bad_file(f"the CGNS file is no HDF5 file: {remedy}")
    import h5py

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            bases = list(_children(file, "CGNSBase_t"))
            zones = [(name, zone) for _, base in bases for name, zone in _children(base, "Zone_t")]
            if len(bases) != 1 or not 1 <= len(zones) <= MAX_ZONES:
                raise bad_file(
                    f"the CGNS file has {len(bases)} bases and {len(zones)} zones: one base with zones is read"
                )
            blocks = _blocks(zones, len(data))
            sides: dict[str, list[tuple[int, IntArray]]] = {}
            left = sum(2 * sum(block.shape[:2]) for block in blocks)  # edges that may have a side yet
            for number, (name, zone) in enumerate(zones):
                for side, edges in _sides(name, zone, blocks[number].shape):
                    left -= len(edges)
                    if left < 0:
                        raise bad_file(
                            f"the zone {name!r}: the sides have more edges than the zones: give each one side"
                        )
                    sides.setdefault(side, []).append((number, edges))
    except InputError:
        raise
    except BROKEN as error:
        raise bad_file(f"the CGNS file cannot be read: {str(error)[:200]}") from error
    named = tuple((name, (b.shape[0] - 1) * (b.shape[1] - 1)) for (name, _), b in zip(zones, blocks, strict=True))
    return replace(joined(blocks, sides), blocks=named)


def _blocks(zones: list[tuple[str, h5py.Group]], size: int) -> list[Array]:
    """The coordinates of all zones of a file of ``size`` bytes, of which each zone has its own."""
    blocks: list[Array] = []
    left = size
    for name, zone in zones:
        blocks.append(_nodes(name, zone, size))
        left -= blocks[-1].size  # a number has one byte at least
        if left < 0:
            raise bad_file(
                f"the zone {name!r} has more nodes than the file has place for: save each zone with its own array"
            )
    return blocks


def _children(group: h5py.Group, label: str) -> Iterator[tuple[str, h5py.Group]]:
    """The nodes of a kind below a node, in the order in which they were made, where the file has it."""
    import h5py

    names: list[bytes] = []
    tracked = group.id.get_create_plist().get_link_creation_order() & h5py.h5p.CRT_ORDER_TRACKED
    order = h5py.h5.INDEX_CRT_ORDER if tracked else h5py.h5.INDEX_NAME
    group.id.links.iterate(names.append, idx_type=order)
    for name in (bytes(raw).decode() for raw in names):
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            child = group[name]
            found = child.attrs.get("label", b"")
            text = found.decode() if isinstance(found, bytes) else str(found)
            if isinstance(child, h5py.Group) and text.rstrip("\0 ") == label:
                yield name, child


def _data(node: h5py.Group, where: str, most: int) -> Any:
    """The array of a node, of ``most`` bytes at most; its axes are in the order of Fortran backwards."""
    import h5py

    dataset = node.get(" data") if isinstance(node.get(" data", getlink=True), h5py.HardLink) else None
    if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual or dataset.chunks is not None:
        raise bad_file(f"{where} has no plain array: save the file as one, without links and packing")
    if dataset.dtype.kind not in "fiuS" or dataset.nbytes > most:
        raise bad_file(f"{where} has {dataset.size} entries of the type {dataset.dtype}")
    return dataset[()]


def _label(node: h5py.Group, where: str) -> str:
    """The text of a node, which is an array of characters."""
    return bytes(np.asarray(_data(node, where, 1 << 16)).astype(np.uint8)).decode().strip("\0 ")


def _nodes(name: str, zone: h5py.Group, most: int) -> Array:
    """The coordinates of a zone, shape ``(n_i, n_j, 2 or 3)``."""
    where = f"the zone {name!r}"
    kinds = [_label(node, f"{where}: ZoneType") for _, node in _children(zone, "ZoneType_t")]
    if kinds != ["Structured"]:
        raise bad_file(f"{where} is {' '.join(kinds) or 'of no type'}: structured zones are read; save it as .vtu")
    shape = np.atleast_2d(_data(zone, where, most))[0].tolist()
    n_k = shape[2] if len(shape) == 3 else 1
    if len(shape) not in (2, 3) or not all(2 <= n <= MAX_ZONE_NODES for n in shape[:2]) or n_k not in (1, 2):
        sizes = " x ".join(map(str, shape))
        raise bad_file(f"{where} has {sizes} nodes: plane zones, or one layer of cells along k, can be adapted")
    arrays = {
        axis: node
        for _, grid in list(_children(zone, "GridCoordinates_t"))[:1]
        for axis, node in _children(grid, "DataArray_t")
    }
    found = []
    for axis in ("CoordinateX", "CoordinateY", "CoordinateZ"):
        if axis not in arrays:
            if axis != "CoordinateZ":
                raise bad_file(f"{where} has no {axis}: x and y are needed")
            continue
        values = np.asarray(_data(arrays[axis], f"{where}: {axis}", most), dtype=np.float64)
        if values.shape != tuple(shape[::-1]):
            raise bad_file(f"{where}: {axis} has {values.shape[::-1]} nodes where the zone has {tuple(shape)}")
        found.append((values[0] if len(shape) == 3 else values).T)
    return np.stack(found, axis=-1)


def _sides(name: str, zone: h5py.Group, shape: tuple[int, ...]) -> Iterator[tuple[str, IntArray]]:
    """The name of each boundary condition of a zone, and its edges of nodes ``i * n_j + j``, shape ``(k, 2)``."""
    for _, conditions in _children(zone, "ZoneBC_t"):
        for own, condition in _children(conditions, "BC_t"):
            where = f"the zone {name!r}: the boundary condition {own!r}"
            side = next((_label(node, where) for _, node in _children(condition, "FamilyName_t")), own)
            ranges = [node for title, node in _children(condition, "IndexRange_t") if title == "PointRange"]
            if len(ranges) != 1:
                raise bad_file(f"{where} has no PointRange: give the range of its points")
            at = next((_label(node, where) for _, node in _children(condition, "GridLocation_t")), AT_NODES)
            edges = _edges(np.asarray(_data(ranges[0], where, 1 << 16)), at, shape[:2], where)
            if edges is not None:
                yield side, edges


def _edges(ends: IntArray, at: str, shape: tuple[int, ...], where: str) -> IntArray | None:
    """The edges of a range of points, shape ``(2, axes)``, which begins at 1; none for a face in the plane itself."""
    if ends.ndim != 2 or ends.shape[0] != 2 or ends.shape[1] not in (2, 3) or at not in (AT_NODES, *ON_FACES):
        raise bad_file(f"{where}: a PointRange at {at} of the shape {ends.shape[::-1]} is not read")
    low, high = (limit(ends[:, :2].astype(np.int64), axis=0) for limit in (np.min, np.max))
    if ends.shape[1] == 3 and ends[0, 2] == ends[1, 2] and (low < high).all():
        return None
    for along, across in ((1, 0), (0, 1)):
        first, last = int(low[along]), int(high[along]) + (at != AT_NODES)
        fixed = int(low[across])
        if fixed != high[across] or fixed not in (1, shape[across]) or not 1 <= first < last <= shape[along]:
            continue
        steps = np.arange(first - 1, last)
        line = (fixed - 1) * shape[1] + steps if along == 1 else steps * shape[1] + fixed - 1
        return np.column_stack([line[:-1], line[1:]])
    raise bad_file(
        f"{where} has the points {low.tolist()} to {high.tolist()}, which are no part of a side of the"
        f" {shape[0]} x {shape[1]} nodes"
    )
