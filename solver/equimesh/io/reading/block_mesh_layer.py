"""A layer of hexahedra of a blockMeshDict, seen from above: its blocks and vertices in the plane."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.foam_dictionary import Item, as_word, numbers_of
from equimesh.numerics.types import Array, BoolArray

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
        raise InputError(f"line {word.line}: vertex {number} is none of the {len(numbers)} vertices", field="file")
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
    message = f"{where}: only plane meshes can be adapted"
    raise InputError(message, field="file")


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
        raise InputError(f"line {block.line}: {min(cells)} cells: at least 1 is needed", field="file")
    entry: dict[str, Any] = {"name": block.name} if block.name else {}
    entry |= {"corners": corners, "cells": cells}
    if gradings[0] == gradings[1] and gradings[2] == gradings[3]:
        gradings = gradings[::2]
    return entry if all(ratio == 1.0 for ratio in gradings) else entry | {"grading": gradings}
