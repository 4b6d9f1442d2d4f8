"""Descriptions of domains in blocks from the literal subset of OpenFOAM's blockMeshDict."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
import scipy

from equimesh.io.reading.bounds import bad_file
from equimesh.io.reading.foam import (
    Dictionary,
    Entries,
    Item,
    Items,
    Word,
    as_items,
    as_word,
    list_of,
    numbers_of,
    one_word,
    parse,
    text_of,
)
from equimesh.numerics.types import Array, BoolArray

# A layer of hexahedra of a blockMeshDict, seen from above: its blocks and vertices in the plane.

Point: TypeAlias = tuple[float, float]

# The four vertices of a hexahedron on each side of the layer, by its local axes, and the numbers of their edges: along
# i at j = 0 and at its end, along j at i = 0 and at its end.
PLANES: Final = (
    ((0, 1, 2, 3), (0, 1, 4, 5), (0, 1)),
    ((4, 5, 6, 7), (3, 2, 7, 6), (0, 1)),
    ((0, 3, 7, 4), (4, 7, 8, 11), (1, 2)),
    ((1, 2, 6, 5), (5, 6, 9, 10), (1, 2)),
    ((0, 1, 5, 4), (0, 3, 8, 9), (0, 2)),
    ((3, 2, 6, 7), (1, 2, 11, 10), (0, 2)),
)
# The vertices of each face of a hexahedron, in the order of OpenFOAM.
FACES: Final = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
# Vertices are in a plane where they leave it by this part of the size at most; circles are one where they differ less.
SAME: Final = 1e-9
# The two coordinates of a plane across x, y or z.
ACROSS: Final = {0: (1, 2), 1: (0, 2), 2: (0, 1)}


@dataclass(frozen=True)
class Hex:
    """A block of the dictionary: its 8 vertices, cells along the local axes, and the grading of its 12 edges."""

    vertices: tuple[int, ...]
    cells: tuple[int, ...]
    gradings: tuple[Any, ...]
    name: str
    line: int


@dataclass(eq=False)
class Layer:
    """Vertices in space, shape ``(v, 3)``, and their names; the layer is across ``axis``.

    ``lower`` says which vertices are in the lower plane, ``below`` which of them is below each other vertex. Numbers of
    the dictionary are multiplied by ``scale``.
    """

    points: Array
    names: list[str]
    scale: float
    axis: int
    lower: BoolArray
    blocks: list[Hex]
    below: dict[int, int] = field(default_factory=dict)

    @cached_property
    def numbers(self) -> dict[str, int]:
        """The number of each vertex, by its name."""
        return {name: k for k, name in enumerate(self.names)}

    def plane(self, vertex: int) -> Point:
        """The place of a vertex in the plane."""
        first, second = ACROSS[self.axis]
        return float(self.points[vertex, first]), float(self.points[vertex, second])

    def name(self, vertex: int) -> str:
        """The name of a vertex of the lower plane, or of the one below."""
        return self.names[self.below.get(vertex, vertex)]

    def place(self, item: Item) -> Point:
        """A point ``(x y z)`` of the dictionary in the plane."""
        numbers, (first, second) = numbers_of(item, 3), ACROSS[self.axis]
        return self.scale * numbers[first], self.scale * numbers[second]


def vertex_of(item: Item, numbers: Mapping[str, int]) -> int:
    """The number of a vertex, by its name, or by its number where that is no name."""
    word = as_word(item)
    number = numbers[word.text] if word.text in numbers else word.integer()
    if not 0 <= number < len(numbers):
        raise bad_file(f"line {word.line}: vertex {number} is none of the {len(numbers)} vertices")
    return number


def layer_of(points: Array, names: list[str], scale: float, blocks: list[Hex]) -> Layer:
    """The layer in which all blocks lie; of each vertex the one in the lower plane."""
    used = np.unique([vertex for block in blocks for vertex in block.vertices]).astype(np.int64)
    size = float(np.ptp(points[used], axis=0).max()) if len(used) else 0.0
    for axis in (2, 1, 0):
        values = points[used, axis]
        if not len(values) or not values.max() > values.min():
            continue
        lower = points[:, axis] < 0.5 * (values.min() + values.max())
        apart = np.where(lower[used], values - values.min(), values.max() - values)
        if apart.max() > SAME * size:
            continue
        layer = Layer(points, names, scale, axis, lower, blocks)
        if all(_take_pairs(layer, block, SAME * size) for block in blocks):
            return layer
    line = blocks[0].line if blocks else 1
    where = f"line {line}: the blocks are no layer of one cell between two planes across x, y or z"
    raise bad_file(f"{where}: only plane meshes can be adapted")


def _take_pairs(layer: Layer, block: Hex, near: float) -> bool:
    """Note which vertex is below which; whether the block goes straight from plane to plane."""
    for quad, _, axes in PLANES:
        if not all(layer.lower[block.vertices[k]] for k in quad) or block.cells[3 - sum(axes)] != 1:
            continue
        other = _across(quad)
        for one, above in zip(quad, other, strict=True):
            low, high = block.vertices[one], block.vertices[above]
            if layer.lower[high] or math.dist(layer.plane(low), layer.plane(high)) > near:
                return False
            layer.below[high] = low
        return True
    return False


def _across(quad: tuple[int, ...]) -> tuple[int, ...]:
    """The vertices of a hexahedron on the other side of a face, in the same order."""
    place = next(k for k, (corners, *_) in enumerate(PLANES) if corners == quad)
    return PLANES[place ^ 1][0]


def block_entry(layer: Layer, block: Hex) -> dict[str, Any]:
    """The entry of a block, its corners counter-clockwise in the plane."""
    quad, edges, axes = next(p for p in PLANES if all(layer.lower[block.vertices[k]] for k in p[0]))
    corners = [layer.name(block.vertices[k]) for k in quad]
    cells = [block.cells[axis] for axis in axes]
    gradings = [block.gradings[edge] for edge in edges]
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = (layer.plane(block.vertices[k]) for k in quad)
    if (cx - ax) * (dy - by) - (cy - ay) * (dx - bx) < 0.0:
        corners, cells = [corners[k] for k in (0, 3, 2, 1)], cells[::-1]
        gradings = gradings[2:] + gradings[:2]
    if any(count < 1 for count in cells):
        raise bad_file(f"line {block.line}: {min(cells)} cells: at least 1 is needed")
    entry: dict[str, Any] = {"name": block.name} if block.name else {}
    entry |= {"corners": corners, "cells": cells}
    if gradings[0] == gradings[1] and gradings[2] == gradings[3]:
        gradings = gradings[::2]
    return entry if all(ratio == 1.0 for ratio in gradings) else entry | {"grading": gradings}


# The curved edges and the patches of a blockMeshDict, as entries of a description of blocks.

# Different circles of a dictionary, at most.
MAX_CIRCLES: Final = 10_000


class _Circles:
    """The circles of arcs, each of which is one curve."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._rows = np.empty((0, 3))  # centers and radii, of as many as there is room for

    def find(self, center: Array, radius: float) -> str | None:
        """The name of a circle that differs by next to nothing."""
        rows = self._rows[: len(self._names)]
        same = (np.abs(rows - [*center, radius]) <= SAME * radius).all(axis=1)
        return self._names[int(same.argmax())] if same.any() else None

    def add(self, name: str, center: Array, radius: float) -> None:
        """Take a new circle."""
        if len(self._names) == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty((len(self._rows) + 64, 3))])
        self._rows[len(self._names)] = [*center, radius]
        self._names.append(name)

    def __len__(self) -> int:
        return len(self._names)


def edge_entries(layer: Layer, items: Sequence[Item], curves: dict[str, Any]) -> list[dict[str, Any]]:
    """The entries of the edges in the lower plane that are no straight lines; their curves are added to ``curves``."""
    found, rest, circles = [], deque(items), _Circles()
    while rest:
        kind = rest.popleft()
        name = text_of(kind)
        if name not in ("line", "arc", "spline", "polyLine") or len(rest) < 2:
            raise bad_file(f"line {kind.line}: the edge {name[:30]!r} is not read: line, arc, spline and polyLine are")
        first, last = (vertex_of(rest.popleft(), layer.numbers) for _ in range(2))
        taken = 0 if name == "line" else 2 if rest and text_of(rest[0]) == "origin" else 1
        given = [rest.popleft() for _ in range(min(taken, len(rest)))]
        in_plane = layer.lower[first] and layer.lower[last] and first != last
        if name == "line" or not in_plane:
            continue
        entry: dict[str, Any] = {"from": layer.name(first), "to": layer.name(last)}
        if name == "arc":
            entry |= _arc(layer, first, last, given, curves, circles, kind.line)
        else:
            between = [layer.place(as_items(item)) for item in as_items(given[0] if given else kind).items]
            points = [list(place) for place in (layer.plane(first), *between, layer.plane(last))]
            entry["on"] = f"curve{len(curves)}"
            curves[entry["on"]] = {"points" if name == "spline" else "polyline": points}
        found.append(entry)
    return found


def _arc(
    layer: Layer, first: int, last: int, given: list[Item], curves: dict[str, Any], circles: _Circles, line: int
) -> dict[str, Any]:
    """The circle of an arc through a point, or around an origin."""
    a, b = np.array(layer.plane(first)), np.array(layer.plane(last))
    if len(given) == 2:
        center, via = np.array(layer.place(as_items(given[1]))), None
    elif given and isinstance(given[0], Items) and len(given[0].items) == 3:
        via = np.array(layer.place(given[0]))
        one, other = via - a, b - a
        twice = 2.0 * (one[0] * other[1] - one[1] * other[0])
        if abs(twice) <= SAME * float(other @ other):
            raise bad_file(f"line {line}: the three points of the arc lie on a straight line")
        rise = np.array(
            [other[1] * (one @ one) - one[1] * (other @ other), one[0] * (other @ other) - other[0] * (one @ one)]
        )
        center = a + rise / twice
    else:
        raise bad_file(f"line {line}: an arc is: arc <vertex> <vertex> (x y z)")
    radius = float(np.hypot(*(a - center)))
    entry: dict[str, Any] = {} if via is None else {"via": via.tolist()}
    name = circles.find(center, radius)
    if name is None:
        if len(circles) == MAX_CIRCLES:
            raise bad_file(f"line {line}: the arcs have more than {MAX_CIRCLES} circles")
        name = f"circle{len(curves)}"
        circles.add(name, center, radius)
        curves[name] = {"circle": {"center": center.tolist(), "radius": radius}}
    return {"on": name} | entry


def sides_and_joins(layer: Layer, entries: Dictionary) -> tuple[dict[str, list[list[str]]], list[dict[str, Any]]]:
    """The edges of each patch that is no plane, and the joins of cyclic patches."""
    sides: dict[str, list[list[str]]] = {}
    cyclic: dict[str, str] = {}
    items = list(list_of(entries, "boundary", needed=False))
    for name, patch in zip(items[::2], items[1::2], strict=False):
        if not isinstance(patch, Entries):
            raise bad_file(f"line {name.line}: the patch {text_of(name)[:30]!r} needs {{ ... }}")
        edges = _patch(layer, patch.values.get("faces", []))
        if edges:
            sides[text_of(name).strip('"')] = edges
        if "neighbourPatch" in patch.values and edges:
            cyclic[text_of(name)] = one_word(patch.values["neighbourPatch"], "neighbourPatch").text
    old = list(list_of(entries, "patches", needed=False))
    for _, name, faces in zip(old[::3], old[1::3], old[2::3], strict=False):
        if edges := _patch(layer, [faces]):
            sides[text_of(name)] = edges
    joins = []
    for one, other in cyclic.items():
        if cyclic.get(other) == one and one in sides and other in sides:
            joins += _joins(layer, sides.pop(one), sides.pop(other))
    return sides, joins


def _joins(layer: Layer, edges: list[list[str]], others: list[list[str]]) -> list[dict[str, Any]]:
    """Each edge of a cyclic patch with the one of its neighbour that lies at the same place, moved."""
    ways = [way for other in others for way in (other, other[::-1])]
    here, there = (
        np.array([[layer.plane(layer.numbers[name]) for name in edge] for edge in table]) for table in (edges, ways)
    )
    moved = here + there.mean(axis=(0, 1)) - here.mean(axis=(0, 1))
    nearest = np.asarray(scipy.spatial.KDTree(there.reshape(-1, 4)).query(moved.reshape(-1, 4))[1])
    return [{"from": edge, "to": ways[k]} for edge, k in zip(edges, nearest.tolist(), strict=True)]


def _patch(layer: Layer, items: Sequence[Item]) -> list[list[str]]:
    """The edges in the plane of the faces of a patch; none for faces that are in a plane."""
    edges = []
    for face in (face for item in items for face in as_items(item).items):
        found = as_items(face).items
        numbers = (
            [vertex_of(item, layer.numbers) for item in found] if len(found) == 4 else _of_block(found, face, layer)
        )
        ends = list(dict.fromkeys(layer.name(vertex) for vertex in numbers))
        if len(ends) == 2:
            edges.append(ends)
    return edges


def _of_block(found: Sequence[Item], face: Item, layer: Layer) -> list[int]:
    """The vertices of a face that is given as the number of a block and of its face."""
    numbers = [as_word(item).integer() for item in found]
    if len(numbers) != 2 or not (0 <= numbers[0] < len(layer.blocks) and 0 <= numbers[1] < 6):
        raise bad_file(f"line {face.line}: a face is 4 vertices, or a block and a face of it")
    return [layer.blocks[numbers[0]].vertices[k] for k in FACES[numbers[1]]]


# Entries that change what is meshed, and that are refused.
REFUSED: Final = ("transform", "prescale", "mergePatchPairs")


def read_block_mesh_dict(text: str) -> dict[str, Any]:
    """The description of blocks, as JSON, that a blockMeshDict of one layer of blocks gives.

    Read are ``scale`` or ``convertToMeters``, ``vertices``, ``blocks`` with ``simpleGrading`` and ``edgeGrading``,
    ``edges`` (``line``, ``arc``, ``spline``, ``polyLine``), and ``boundary`` or ``patches``: patches in the two planes
    are left out, pairs of cyclic patches become joins. Code, calculations, files and projections are refused. Raises
    :class:`~equimesh.errors.InputError` with the line.

    Source: OpenFOAM user guide, "Mesh generation with the blockMesh utility".
    """
    entries = parse(text)
    for name in REFUSED:
        found = entries.values.get(name, [])
        if any(not isinstance(item, Items) or item.items for item in found):
            line = found[0].line
            raise bad_file(f"line {line}: {name} is not read: mesh with blockMesh, and read constant/polyMesh")
    points, names, scale = _vertices(entries)
    blocks = _hexes(list_of(entries, "blocks"), {name: k for k, name in enumerate(names)})
    layer = layer_of(points, names, scale, blocks)
    listed = [block_entry(layer, block) for block in blocks]
    curves: dict[str, Any] = {}
    edges = edge_entries(layer, list_of(entries, "edges", needed=False), curves)
    sides, joins = sides_and_joins(layer, entries)
    used = dict.fromkeys(name for block in listed for name in block["corners"])
    place = {layer.names[k]: list(layer.plane(k)) for k in range(len(names))}
    document: dict[str, Any] = {"kind": "blocks", "vertices": {name: place[name] for name in used}}
    for member, value in (("curves", curves), ("edges", edges)):
        if value:
            document[member] = value
    document["blocks"] = listed
    for member, value in (("joins", joins), ("sides", sides)):
        if value:
            document[member] = value
    return document


def _vertices(entries: Dictionary) -> tuple[Array, list[str], float]:
    """The scaled places of the vertices, shape ``(v, 3)``, and their names (their numbers unless given); the scale."""
    scale = 1.0
    for name in ("convertToMeters", "scale"):
        if name in entries.values:
            scale = one_word(entries.values[name], name).number()
    points: list[list[float]] = []
    names: list[str] = []
    items = deque(list_of(entries, "vertices"))
    while items:
        item, name = items.popleft(), str(len(points))
        if isinstance(item, Word) and item.text == "name" and len(items) > 1:
            given, item = items.popleft(), items.popleft()
            name = given.text if isinstance(given, Word) else name
        if not isinstance(item, Items):
            raise bad_file(f"line {item.line}: {text_of(item)!r} is no vertex (x y z)")
        points.append([scale * number for number in numbers_of(item, 3)])
        names.append(name)
    return np.array(points, dtype=np.float64).reshape(-1, 3), names, scale


def _hexes(items: Sequence[Item], numbers: Mapping[str, int]) -> list[Hex]:
    """The blocks: ``hex (8 vertices) [zone] (3 counts) simpleGrading (3)``."""
    found, rest = [], deque(items)
    while rest:
        word = rest.popleft()
        if not isinstance(word, Word) or word.text != "hex":
            raise bad_file(f"line {word.line}: {text_of(word)!r} where a block 'hex' is expected")
        vertices = _taken(rest, word, "8 vertices")
        zone = rest.popleft().text if rest and isinstance(rest[0], Word) else ""  # type: ignore[union-attr]
        cells, kind = _taken(rest, word, "3 numbers of cells"), rest.popleft() if rest else word
        gradings = _taken(rest, word, "a grading")
        count = {"simpleGrading": 3, "edgeGrading": 12}.get(text_of(kind), 0)
        if not count or len(vertices.items) != 8 or len(cells.items) != 3 or len(gradings.items) not in (1, count):
            raise bad_file(
                f"line {word.line}: a block is: hex (8 vertices) (3 numbers of cells) simpleGrading (3 ratios)"
            )
        ratios = [_grading(item) for item in gradings.items] * (count // len(gradings.items))
        if count == 3:
            ratios = [ratio for ratio in ratios for _ in range(4)]
        corners = tuple(vertex_of(item, numbers) for item in vertices.items)
        counts = tuple(as_word(item).integer() for item in cells.items)
        found.append(Hex(corners, counts, tuple(ratios), zone, word.line))
    return found


def _grading(item: Item) -> Any:
    """A ratio, or sections ``[length, cells, ratio]``; a negative ratio is one over its amount."""
    if isinstance(item, Items):
        return [
            [*numbers_of(as_items(section), 3)[:2], _positive(numbers_of(as_items(section), 3)[2])]
            for section in item.items
        ]
    return _positive(as_word(item).number())


def _positive(ratio: float) -> float:
    return -1.0 / ratio if ratio < 0.0 else ratio


def _taken(rest: deque[Item], word: Word, what: str) -> Items:
    """The next item, which is a list."""
    if not rest or not isinstance(rest[0], Items):
        raise bad_file(f"line {word.line}: {what} in ( ) are missing")
    return as_items(rest.popleft())
