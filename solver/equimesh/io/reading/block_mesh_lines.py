"""The curved edges and the patches of a blockMeshDict, as entries of a description of blocks."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import KDTree

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_layer import SAME, Layer, vertex_of
from equimesh.io.reading.foam_dictionary import (
    Dictionary,
    Entries,
    Item,
    Items,
    as_items,
    as_word,
    list_of,
    one_word,
    text_of,
)
from equimesh.numerics.types import Array

# The vertices of each face of a hexahedron, in the order of OpenFOAM.
FACES: Final = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))


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
            message = f"line {kind.line}: the edge {name[:30]!r} is not read: line, arc, spline and polyLine are"
            raise InputError(message, field="file")
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
            raise InputError(f"line {line}: the three points of the arc lie on a straight line", field="file")
        rise = np.array(
            [other[1] * (one @ one) - one[1] * (other @ other), one[0] * (other @ other) - other[0] * (one @ one)]
        )
        center = a + rise / twice
    else:
        raise InputError(f"line {line}: an arc is: arc <vertex> <vertex> (x y z)", field="file")
    radius = float(np.hypot(*(a - center)))
    entry: dict[str, Any] = {} if via is None else {"via": via.tolist()}
    name = circles.find(center, radius)
    if name is None:
        if len(circles) == MAX_CIRCLES:
            raise InputError(f"line {line}: the arcs have more than {MAX_CIRCLES} circles", field="file")
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
            raise InputError(f"line {name.line}: the patch {text_of(name)[:30]!r} needs {{ ... }}", field="file")
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
    nearest = np.asarray(KDTree(there.reshape(-1, 4)).query(moved.reshape(-1, 4))[1])
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
        raise InputError(f"line {face.line}: a face is 4 vertices, or a block and a face of it", field="file")
    return [layer.blocks[numbers[0]].vertices[k] for k in FACES[numbers[1]]]
