"""Descriptions of blocks from OpenFOAM's blockMeshDict, the literal subset of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_layer import Hex, block_entry, layer_of, vertex_of
from equimesh.io.reading.block_mesh_lines import edge_entries, sides_and_joins
from equimesh.io.reading.foam_dictionary import (
    Dictionary,
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
from equimesh.numerics.types import Array

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
            message = f"line {line}: {name} is not read: mesh with blockMesh, and read constant/polyMesh"
            raise InputError(message, field="file")
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
            raise InputError(f"line {item.line}: {text_of(item)!r} is no vertex (x y z)", field="file")
        points.append([scale * number for number in numbers_of(item, 3)])
        names.append(name)
    return np.array(points, dtype=np.float64).reshape(-1, 3), names, scale


def _hexes(items: Sequence[Item], numbers: Mapping[str, int]) -> list[Hex]:
    """The blocks: ``hex (8 vertices) [zone] (3 counts) simpleGrading (3)``."""
    found, rest = [], deque(items)
    while rest:
        word = rest.popleft()
        if not isinstance(word, Word) or word.text != "hex":
            raise InputError(f"line {word.line}: {text_of(word)!r} where a block 'hex' is expected", field="file")
        vertices = _taken(rest, word, "8 vertices")
        zone = rest.popleft().text if rest and isinstance(rest[0], Word) else ""  # type: ignore[union-attr]
        cells, kind = _taken(rest, word, "3 numbers of cells"), rest.popleft() if rest else word
        gradings = _taken(rest, word, "a grading")
        count = {"simpleGrading": 3, "edgeGrading": 12}.get(text_of(kind), 0)
        if not count or len(vertices.items) != 8 or len(cells.items) != 3 or len(gradings.items) not in (1, count):
            message = f"line {word.line}: a block is: hex (8 vertices) (3 numbers of cells) simpleGrading (3 ratios)"
            raise InputError(message, field="file")
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
        raise InputError(f"line {word.line}: {what} in ( ) are missing", field="file")
    return as_items(rest.popleft())
