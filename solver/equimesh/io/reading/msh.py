"""Meshes from Gmsh files: text of versions 2 and 4, and binary ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.io.reading.bounds import bad_file, floats, integers
from equimesh.io.reading.plain_mesh import PlainMesh, check_side_count, refuse_cell
from equimesh.numerics.types import Array, IntArray

# The nodes and elements of binary Gmsh files, as arrays.

# Blocks of nodes or elements, at most.
MAX_BLOCKS: Final = 100_000
# Physical groups of one point or curve, at most: each takes all its lines.
MAX_GROUPS: Final = 10

Numbers = npt.NDArray[Any]


@dataclass
class Bytes:
    """Numbers in the bytes of a section, one after another; ``order`` is ``<`` or ``>``."""

    data: bytes
    order: str
    at: int = 0

    def take(self, kind: str, count: int) -> Numbers:
        """The next ``count`` numbers of a kind of NumPy, ``i4``, ``u8`` or ``f8``."""
        dtype = np.dtype(f"{self.order}{kind}")
        if not 0 <= count <= (len(self.data) - self.at) // dtype.itemsize:
            raise bad_file("a section of the binary Gmsh file ends too early")
        found = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return found

    def line(self) -> int:
        """The number in the next line of text."""
        end = self.data.find(b"\n", self.at, self.at + 30)
        word = self.data[self.at : end].strip()
        if end < 0 or not word.isdigit():
            raise bad_file("a section of the binary Gmsh file does not begin with a number")
        self.at = end + 1
        return int(word)


def order_of(head: bytes) -> str:
    """The order of bytes, from the text of ``$MeshFormat``: the number 1 stands in its second line."""
    mark = head.partition(b"\n")[2][:4]
    if mark not in (b"\x01\x00\x00\x00", b"\x00\x00\x00\x01"):
        raise bad_file("the binary Gmsh file does not tell the order of its bytes: save it again")
    return "<" if mark[0] else ">"


def nodes_22(data: Bytes) -> tuple[Array, IntArray]:
    """Coordinates, shape ``(n, 3)``, and numbers of the nodes of version 2."""
    count = data.line()
    rows = data.take("i4", 7 * count).reshape(count, 7)
    places = np.ascontiguousarray(rows[:, 1:]).view(f"{data.order}f8")
    return places.astype(np.float64), rows[:, 0].astype(np.int64)


def elements_22(data: Bytes, width_of: Callable[[int], int]) -> Iterator[tuple[int, Numbers]]:
    """Blocks of elements of version 2: their type, and rows of number, group (0 for none) and nodes.

    ``width_of`` has the number of nodes of a type. Some programs write a block for each element: those are joined.
    """
    left = data.line()
    for _ in range(MAX_BLOCKS):
        if left == 0:
            return
        kind, count, tags = data.take("i4", 3).tolist()
        if count < 1 or tags < 0:
            raise bad_file("a block of the binary Gmsh file has no elements: save it again")
        width = 1 + tags + width_of(kind)
        rows = data.take("i4", count * width).reshape(count, width)
        if count == 1:
            rows = np.concatenate([rows, _single(data, (kind, 1, tags), width, left - 1)])
        left -= len(rows)
        group = rows[:, 1:2] if tags else np.zeros_like(rows[:, :1])
        yield kind, np.concatenate([rows[:, :1], group, rows[:, 1 + tags :]], axis=1).astype(np.int64)
    raise bad_file(f"the binary Gmsh file has more than {MAX_BLOCKS} blocks of elements")


def _single(data: Bytes, head: tuple[int, int, int], width: int, most: int) -> Numbers:
    """The rows of the blocks of one element that follow with this head."""
    kind = np.dtype(f"{data.order}i4")
    possible = min(most, (len(data.data) - data.at) // (kind.itemsize * (3 + width)))
    size = min(64, possible)
    while True:
        table = np.frombuffer(data.data, kind, size * (3 + width), data.at).reshape(size, 3 + width)
        other = (table[:, :3] != head).any(axis=1)
        same = int(other.argmax()) if other.any() else size
        if same < size or size == possible:
            data.at += same * (3 + width) * kind.itemsize
            return table[:same, 3:]
        size = min(2 * size, possible)


def groups_of_entities(data: Bytes) -> dict[tuple[int, int], list[int]]:
    """The physical groups of points and curves of version 4.1, by dimension and number of the entity."""
    counts = data.take("u8", 4).tolist()
    if counts[0] + counts[1] > MAX_BLOCKS:
        raise bad_file(f"the binary Gmsh file has more than {MAX_BLOCKS} points and curves")
    found = {}
    for dimension, count in enumerate(counts[:2]):
        for _ in range(count):
            entity = int(data.take("i4", 1)[0])
            data.take("f8", 6 if dimension else 3)
            number = int(data.take("u8", 1)[0])
            if number > MAX_GROUPS:
                raise bad_file(f"{number} physical groups of one entity: {MAX_GROUPS} are possible")
            found[dimension, entity] = np.abs(data.take("i4", number)).tolist()
            if dimension:
                data.take("i4", int(data.take("u8", 1)[0]))
    return found


def nodes_41(data: Bytes) -> tuple[Array, IntArray]:
    """Coordinates, shape ``(n, 3)``, and numbers of the nodes of version 4.1, which has them by entity."""
    points, tags = [np.empty((0, 3))], [np.empty(0, np.int64)]
    for _ in range(_blocks(data)):
        dimension, _, parametric = data.take("i4", 3).tolist()
        count = int(data.take("u8", 1)[0])
        if not 0 <= dimension <= 3:
            raise bad_file("the nodes of the binary Gmsh file are on an unknown entity")
        tags.append(data.take("u8", count).astype(np.int64))
        columns = 3 + (dimension if parametric else 0)
        points.append(data.take("f8", count * columns).reshape(count, columns)[:, :3].astype(np.float64))
    return np.concatenate(points), np.concatenate(tags)


def elements_41(data: Bytes, width_of: Callable[[int], int]) -> Iterator[tuple[tuple[int, int], int, Numbers]]:
    """Blocks of elements of version 4.1: dimension and number of the entity, type, and rows of number and nodes."""
    for _ in range(_blocks(data)):
        dimension, entity, kind = data.take("i4", 3).tolist()
        count, width = int(data.take("u8", 1)[0]), 1 + width_of(kind)
        yield (dimension, entity), kind, data.take("u8", count * width).reshape(count, width).astype(np.int64)


def _blocks(data: Bytes) -> int:
    """The number of blocks of a section of version 4.1."""
    count = int(data.take("u8", 4)[0])
    if count > MAX_BLOCKS:
        raise bad_file(f"a section of the binary Gmsh file has {count} blocks: {MAX_BLOCKS} are possible")
    return count


# Gmsh's numbers of the element types that are read, ...
LINE, QUADRILATERAL, POINT = 1, 3, 15
# ... the names of those that are refused, ...
OTHERS: Final = {
    2: "triangle", 4: "tetrahedron", 5: "hexahedron", 6: "prism", 7: "pyramid", 8: "line of the second order",
    9: "triangle of the second order", 10: "quadrilateral of the second order",
    16: "quadrilateral of the second order",
}  # fmt: skip
# ... and how many nodes they have.
NODES: Final = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 15: 1, 16: 8}
# Sections of a file, at most.
MAX_SECTIONS = 1000
# The dimension of the sides, and of points.
CURVE, VERTEX = 1, 0

_HEAD = re.compile(rb"^\$([A-Za-z]\w*)[^\S\n]*\r?$", re.MULTILINE)


@dataclass(eq=False)
class _Found:
    """What the elements of a file are, with its numbers of nodes and groups; a named point of each group."""

    quads: list[IntArray] = field(default_factory=list)
    lines: list[tuple[IntArray, int]] = field(default_factory=list)
    vertices: dict[int, int] = field(default_factory=dict)
    names: dict[tuple[int, int], str] = field(default_factory=dict)

    def mesh(self, points: Array, tags: IntArray) -> PlainMesh:
        """The mesh, of nodes whose numbers in the file are ``tags``."""
        place = _Places(tags)
        sides: dict[str, list[IntArray]] = {
            name: [] for (dimension, _), name in self.names.items() if dimension == CURVE
        }
        for nodes, group in self.lines:
            if group:
                sides.setdefault(self.names.get((CURVE, group), f"group_{group}"), []).append(nodes)
        quads = np.concatenate(self.quads) if self.quads else np.empty((0, 4), np.int64)
        return PlainMesh.of(
            points,
            place.of(quads),
            {name: place.of(np.concatenate(edges)) for name, edges in sides.items() if edges},
            {
                self.names[VERTEX, group]: int(place.of(np.array([node]))[0])
                for group, node in self.vertices.items()
                if (VERTEX, group) in self.names
            },
        )


class _Places:
    """From the numbers of nodes in the file to their places."""

    def __init__(self, tags: IntArray) -> None:
        self.count = len(tags)
        self.first = int(tags[0]) if len(tags) else 0
        self.order = None if np.array_equal(tags, np.arange(self.first, self.first + self.count)) else np.argsort(tags)
        self.tags = tags if self.order is None else tags[self.order]
        if self.order is not None and (self.tags[1:] == self.tags[:-1]).any():
            twice = int(self.tags[1:][self.tags[1:] == self.tags[:-1]][0])
            raise bad_file(f"node {twice} is in the file twice")

    def of(self, numbers: IntArray) -> IntArray:
        """The places of nodes, by their ``numbers`` in the file."""
        if self.order is None:
            found, known = numbers - self.first, (numbers >= self.first) & (numbers < self.first + self.count)
        else:
            at = np.minimum(np.searchsorted(self.tags, numbers), self.count - 1)
            found, known = self.order[at], self.tags[at] == numbers
        if not known.all():
            raise bad_file(f"an element has node {int(numbers[~known][0])}, which the file does not have")
        return found


def read_msh(data: bytes) -> PlainMesh:
    """The mesh of a Gmsh file; its physical curves are the sides, its physical points the named places.

    Curves of no physical group name no side; a group without a name is called ``group_<number>``. Raises
    :class:`~equimesh.errors.InputError` for another version, for cells that are no quadrilaterals, and for a broken
    file, with the line.

    Source: Gmsh reference manual, "MSH file format".
    """
    sections = {name: (text, line) for name, text, line in islice(_sections(data), MAX_SECTIONS)}
    if "MeshFormat" not in sections:
        raise bad_file("the file does not begin with $MeshFormat: it is no Gmsh file")
    words = sections["MeshFormat"][0].split(None, 3)[:3]
    version, kind = (word.decode("latin-1") for word in [*words, b"", b""][:2])
    if version not in ("2.2", "2.1", "2", "4.1"):
        raise bad_file(f"line 2: version {version[:10]!r} of the Gmsh format: save the mesh in version 2.2 or 4.1")
    for name in ("Nodes", "Elements"):
        if name not in sections:
            raise bad_file(f"the Gmsh file has no section ${name}")
    found = _Found(names=_names(*sections.get("PhysicalNames", (b"0", 0))))
    if kind == "1":
        points, tags = _binary({name: text for name, (text, _) in sections.items()}, version, found)
    elif version == "4.1":
        groups = _groups_of_entities(*sections.get("Entities", (b"", 0)))
        points, tags = _nodes_41(*sections["Nodes"])
        _elements_41(*sections["Elements"], groups, points, found)
    else:
        points, tags = _nodes_22(*sections["Nodes"])
        _elements_22(*sections["Elements"], points, found)
    return found.mesh(points, tags)


def _sections(data: bytes) -> Iterator[tuple[str, bytes, int]]:
    """The name, the text and the first line of each section."""
    at, line, counted = 0, 1, 0
    while (head := _HEAD.search(data, at)) is not None:
        name = head[1]
        end = data.find(b"\n$End" + name, head.end())
        if end < 0:
            line += data.count(b"\n", counted, head.start())
            raise bad_file(f"line {line}: the section ${name.decode('latin-1')} does not end: the file is cut off")
        start = head.end() + 1
        line, counted = line + data.count(b"\n", counted, start), start
        yield name.decode("latin-1"), data[start : end + 1], line
        at = data.find(b"\n", end + 1)
        if at < 0:
            return


def _names(text: bytes, line: int) -> dict[tuple[int, int], str]:
    """The names of physical groups, by dimension and number."""
    names = {}
    for k, row in enumerate(text.split(b"\n")[1:], start=1):
        parts = row.split(None, 2)
        if not parts:
            continue
        try:
            names[int(parts[0]), int(parts[1])] = parts[2].strip().strip(b'"').decode()
        except (ValueError, IndexError) as error:
            raise bad_file(f"line {line + k}: {row[:40]!r} is no name of a physical group") from error
    return names


def _nodes_22(text: bytes, line: int) -> tuple[Array, IntArray]:
    """Coordinates, shape ``(n, 3)``, and numbers of the nodes of version 2."""
    flat = floats(text, line, "the nodes")
    count = int(flat[0]) if len(flat) else 0
    if len(flat) != 1 + 4 * count:
        raise bad_file(f"line {line}: {count} nodes take {4 * count} numbers, but {len(flat) - 1} follow")
    rows = flat[1:].reshape(count, 4)
    return rows[:, 1:], rows[:, 0].astype(np.int64)


def _nodes_41(text: bytes, line: int) -> tuple[Array, IntArray]:
    """The nodes of version 4.1, which lists them by the entity that they are on."""
    flat = floats(text, line, "the nodes")
    points, tags, at = [], [], 4
    for _ in range(_block_count(flat, line)):
        head = flat[at : at + 4]
        if len(head) < 4 or not (0 <= head[0] <= 3 and 0 <= head[3] <= len(flat)):
            raise bad_file(f"line {line}: the nodes end too early")
        count, columns = int(head[3]), 3 + (int(head[0]) if head[2] else 0)
        first, end = at + 4 + count, at + 4 + count * (1 + columns)
        if end > len(flat):
            raise bad_file(f"line {line}: the nodes end too early")
        tags.append(flat[at + 4 : first].astype(np.int64))
        points.append(flat[first:end].reshape(count, columns)[:, :3])
        at = end
    if not tags or at != len(flat):
        raise bad_file(f"line {line}: the blocks of nodes are not as many as their head says")
    return np.concatenate(points), np.concatenate(tags)


def _groups_of_entities(text: bytes, line: int) -> dict[tuple[int, int], list[int]]:
    """The physical groups of points and curves of version 4.1, by dimension and number of the entity."""
    rows = text.split(b"\n")
    groups = {}
    try:
        counts = [int(word) for word in rows[0].split()] or [0, 0]
        for k, row in enumerate(rows[1 : 1 + counts[0] + counts[1]]):
            words, first = row.split(), 4 if k < counts[0] else 7
            tags = [abs(int(word)) for word in words[first + 1 : first + 1 + int(words[first])]]
            if len(tags) > MAX_GROUPS:
                raise bad_file(
                    f"line {line + 1 + k}: {len(tags)} physical groups of one entity: {MAX_GROUPS} are possible"
                )
            groups[VERTEX if k < counts[0] else CURVE, int(words[0])] = tags
    except InputError:
        raise
    except (ValueError, IndexError) as error:
        raise bad_file(f"line {line + len(groups)}: the entities cannot be read") from error
    return groups


def _elements_41(
    text: bytes, line: int, groups: dict[tuple[int, int], list[int]], points: Array, found: _Found
) -> None:
    """Take the elements of version 4.1."""
    flat, at = integers(text, line, "the elements"), 4
    for _ in range(_block_count(flat, line)):
        head = flat[at : at + 4].tolist()
        if len(head) < 4:
            raise bad_file(f"line {line}: the elements end too early")
        dimension, entity, kind, count = head
        width = 1 + _nodes_of(kind)
        end = at + 4 + count * width
        if count < 0 or end > len(flat):
            raise bad_file(f"line {line}: the elements end too early")
        rows = flat[at + 4 : end].reshape(count, width)
        _take_entity(found, kind, rows, groups.get((dimension, entity), []), points)
        at = end
    if len(flat) < 4 or at != len(flat):
        raise bad_file(f"line {line}: the blocks of elements are not as many as their head says")


def _block_count(flat: Array | IntArray, line: int) -> int:
    """The number of blocks that the head of a section of version 4.1 tells."""
    count = int(flat[0]) if len(flat) >= 4 else 0
    if count > MAX_BLOCKS:
        raise bad_file(f"line {line}: the section has {count} blocks: {MAX_BLOCKS} are possible")
    return count


def _elements_22(text: bytes, line: int, points: Array, found: _Found) -> None:
    """Take the elements of version 2: rows of number, type, count of tags, tags (the first is the group), nodes."""
    flat, at, rows, runs = integers(text, line, "the elements"), 1, 0, 0
    while at + 3 <= len(flat):
        kind, tags = int(flat[at + 1]), int(flat[at + 2])
        width = 3 + tags + _nodes_of(kind)
        if tags < 0 or at + width > len(flat):
            break
        runs += 1
        if runs > MAX_BLOCKS:
            raise bad_file(f"line {line}: the type of elements changes more than {MAX_BLOCKS} times: sort them by type")
        same = _run(flat[at:], width)
        table = flat[at : at + same * width].reshape(same, width)
        _take_groups(found, kind, table[:, 0], table[:, 3 + tags :], table[:, 3] if tags else None, points)
        at, rows = at + same * width, rows + same
    if at != len(flat) or not len(flat) or rows != flat[0]:
        told = int(flat[0]) if len(flat) else 0
        raise bad_file(f"line {line}: {told} elements are told, but {rows} whole ones follow")


def _run(flat: IntArray, width: int) -> int:
    """How many rows of ``width`` numbers have the type and the number of tags of the first."""
    most, size = len(flat) // width, 64
    while True:
        table = flat[: min(size, most) * width].reshape(-1, width)
        other = (table[:, 1:3] != table[0, 1:3]).any(axis=1)
        if other.any():
            return int(other.argmax())
        if size >= most:
            return most
        size *= 2


def _nodes_of(kind: int) -> int:
    if kind not in NODES:
        raise bad_file(f"the Gmsh file has elements of the type {kind}: save the mesh with order 1")
    return NODES[kind]


def _take(found: _Found, kind: int, numbers: IntArray, nodes: IntArray, group: int, points: Array) -> None:
    """Add elements of one kind and group."""
    if kind == QUADRILATERAL:
        found.quads.append(nodes)
    elif kind == LINE:
        if len(found.lines) == MAX_BLOCKS:
            raise bad_file(f"the lines change their group more than {MAX_BLOCKS} times: sort them by group")
        found.lines.append((nodes, group))
    elif kind == POINT:
        found.vertices[group] = int(nodes[-1, 0])
    else:
        raise refuse_cell(OTHERS[kind], int(numbers[0]), points, nodes[0] - 1)


def _take_entity(found: _Found, kind: int, rows: IntArray, groups: list[int], points: Array) -> None:
    """Add the elements of one entity, rows of number and nodes, to each of its groups."""
    if len(rows):
        for group in groups if groups and kind != QUADRILATERAL else [0]:
            _take(found, kind, rows[:, 0], rows[:, 1:], group, points)


def _take_groups(
    found: _Found, kind: int, numbers: IntArray, nodes: IntArray, groups: IntArray | None, points: Array
) -> None:
    """Add elements of one kind, each of a group of its own."""
    several = np.unique(groups) if groups is not None and kind in (LINE, POINT) else np.zeros(1, np.int64)
    check_side_count(len(several))
    for group in several.tolist():
        of_it = groups == group if len(several) > 1 else slice(None)
        _take(found, kind, numbers[of_it], nodes[of_it], group, points)


def _binary(sections: dict[str, bytes], version: str, found: _Found) -> tuple[Array, IntArray]:
    """Take the elements of the sections of a binary file; the coordinates and numbers of its nodes."""
    order = order_of(sections["MeshFormat"])
    nodes, elements = (Bytes(sections[name], order) for name in ("Nodes", "Elements"))
    if version == "4.1":
        entities = Bytes(sections.get("Entities", bytes(32)), order)
        groups = groups_of_entities(entities)
        points, tags = nodes_41(nodes)
        for entity, kind, rows in elements_41(elements, _nodes_of):
            _take_entity(found, kind, rows, groups.get(entity, []), points)
    else:
        points, tags = nodes_22(nodes)
        for kind, rows in elements_22(elements, _nodes_of):
            _take_groups(found, kind, rows[:, 0], rows[:, 2:], rows[:, 1], points)
    return points, tags
