"""A small plane mesh with sides for the tests of readers."""

from __future__ import annotations

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.read import read_bytes
from equimesh.numerics.types import IntArray


def small() -> PlainMesh:
    """Three by two bent cells, and four sides, whose numbers no format changes."""
    i, j = np.meshgrid(np.arange(4), np.arange(3), indexing="ij")
    points = np.stack([i / 3 + 0.1 * j**2 / 7, j / 2 + 0.01 * i / 3], axis=-1).reshape(-1, 2)
    number = np.arange(12).reshape(4, 3)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    cells = np.stack([corner.ravel() for corner in corners], axis=1)
    lines = {"left": number[0, ::-1], "right": number[-1], "lower_wall": number[:, 0], "top": number[::-1, -1]}
    return PlainMesh(points=points, cells=cells, sides={name: steps(line) for name, line in lines.items()})


def steps(line: IntArray) -> IntArray:
    """The edges along a line of nodes."""
    return np.column_stack([line[:-1], line[1:]])


def same(one: PlainMesh, other: PlainMesh) -> bool:
    """Whether two meshes agree to the bit, with their sides in order."""
    return (
        np.array_equal(one.points, other.points)
        and np.array_equal(one.cells, other.cells)
        and list(one.sides) == list(other.sides)
        and all(np.array_equal(one.sides[name], other.sides[name]) for name in one.sides)
        and dict(one.places) == dict(other.places)
    )


def refusal(data: bytes | str, format: str) -> str:
    """The message with which a file is refused."""
    try:
        read_bytes(data.encode() if isinstance(data, str) else data, format)
    except InputError as error:
        return error.message
    raise AssertionError("the file is read")
