"""Plane meshes from OpenFOAM's ``polyMesh``, whose cells are one layer between two planes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.foam_dictionary import Entries, Items, Word, parse
from equimesh.io.reading.plain_mesh import PLANE, PlainMesh, refuse_cell
from equimesh.io.reading.text_numbers import floats, integers, line_of
from equimesh.numerics.types import Array, IntArray

# The files of a mesh that are needed; ``neighbour`` says nothing more.
FILES: Final = ("points", "faces", "owner", "boundary")
# Points of a face, at most, where not all faces have four.
MAX_CORNERS: Final = 100
# The other two coordinates of a plane across x, y or z.
ACROSS: Final = {0: (1, 2), 1: (0, 2), 2: (0, 1)}

_HEAD = re.compile(rb"FoamFile\s*\{[^{}]*\}")
_COMMENT = re.compile(rb"//[^\n]*|/\*.*?(?:\*/|\Z)", re.DOTALL)
_PUNCTUATION: Final = bytes.maketrans(b"()", b"  ")


def read_poly_mesh(files: Mapping[str, bytes]) -> PlainMesh:
    """The plane mesh of the files ``points``, ``faces``, ``owner`` and ``boundary``, by name.

    The mesh must be one layer of hexahedra between two planes across x, y or z. The points of the lower plane become
    the nodes, in their order; cells keep their numbers, patches become sides, without their faces in the planes. Raises
    :class:`~equimesh.errors.InputError` for other meshes, for binary files, and for broken ones, with the line.

    Source: OpenFOAM user guide, "Mesh description".
    """
    for name in FILES:
        if name not in files:
            raise InputError(f"the polyMesh has no file {name!r}: it needs {', '.join(FILES)}", field="file")
    points = _vectors(files["points"])
    owner = _list(files["owner"], "owner")
    faces = _faces(files["faces"])
    if len(owner) != len(faces):
        raise InputError(f"polyMesh: {len(owner)} owners of {len(faces)} faces", field="file")
    if faces.max(initial=-1) >= len(points) or owner.min(initial=0) < 0:
        raise InputError("polyMesh: a face has a point, or an owner, that there is not", field="file")
    axis, upper = _layer(points)
    count_upper = np.where(faces >= 0, upper[np.maximum(faces, 0)], False).sum(axis=1)
    corners = (faces >= 0).sum(axis=1)
    below = np.flatnonzero(count_upper == 0)
    other = below[corners[below] != 4]
    if len(other):
        nodes = faces[other[0]]
        raise refuse_cell(_polygon(int(corners[other[0]])), int(owner[other[0]]), points, nodes[nodes >= 0])
    cells = np.full((int(owner.max(initial=-1)) + 1, 4), -1)
    cells[owner[below]] = faces[below][:, 3::-1]
    if len(below) != len(cells) or (cells < 0).any():
        message = f"polyMesh: {len(cells)} cells have {len(below)} faces in the lower plane: one layer has one each"
        raise InputError(message, field="file")
    walls = (count_upper == 2) & (corners == 4)
    astray = ~walls & (count_upper != 0) & (count_upper != corners)
    if astray.any():
        cell = int(owner[astray.argmax()])
        raise InputError(f"polyMesh: cell {cell} does not go straight from plane to plane", field="file")
    sides = {}
    for name, first, count in _patches(files["boundary"], len(faces)):
        own = np.arange(first, first + count)
        own = own[walls[own]]  # the others are in the planes
        if len(own):
            sides[name] = _lower_edges(faces[own, :4], upper)
    return PlainMesh.of(np.ascontiguousarray(points[:, ACROSS[axis]]), cells, sides)


def _layer(points: Array) -> tuple[int, IntArray]:
    """The axis across the layer, and whether each point is in the upper plane."""
    size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    for axis in (2, 1, 0):
        values = points[:, axis]
        if not len(values):
            break
        low, high = values.min(), values.max()
        upper = values > 0.5 * (low + high)
        apart = np.where(upper, high - values, values - low)
        if high > low and 2 * upper.sum() == len(values) and apart.max() <= PLANE * size:
            return axis, upper.astype(np.int64)
    message = (
        "polyMesh: the points do not lie in two planes across x, y or z: only one layer of cells between two planes"
        " can be adapted (extrudeMesh makes one)"
    )
    raise InputError(message, field="file")


def _lower_edges(faces: IntArray, upper: IntArray) -> IntArray:
    """The edge of each face in the lower plane, in the direction in which the face goes around."""
    start = ((upper[faces] == 0) & (upper[np.roll(faces, -1, axis=1)] == 0)).argmax(axis=1)
    rows = np.arange(len(faces))
    return np.column_stack([faces[rows, start], faces[rows, (start + 1) % 4]])


def _body(data: bytes, name: str) -> tuple[bytes, int]:
    """The text of a list after its head, and its first line."""
    head = _HEAD.search(data)
    if head is not None and re.search(rb"format\s+binary", head[0]):
        message = f"polyMesh: the file {name!r} is binary: convert it with foamFormatConvert to ascii"
        raise InputError(message, field="file")
    start = head.end() if head is not None else 0
    return _COMMENT.sub(lambda found: b"\n" * found[0].count(b"\n"), data[start:]), line_of(data, start)


def _list(data: bytes, name: str) -> IntArray:
    """The integers of a list, without their number in front."""
    text, line = _body(data, name)
    flat = integers(text.translate(_PUNCTUATION), line, f"the file {name!r}")
    if not len(flat) or flat[0] != len(flat) - 1:
        raise InputError(f"polyMesh: the list in {name!r} does not have the length that it tells", field="file")
    return flat[1:]


def _vectors(data: bytes) -> Array:
    text, line = _body(data, "points")
    flat = floats(text.translate(_PUNCTUATION), line, "the file 'points'")
    if not len(flat) or 3 * flat[0] != len(flat) - 1:
        raise InputError("polyMesh: the list in 'points' does not have the length that it tells", field="file")
    return flat[1:].reshape(-1, 3)


def _faces(data: bytes) -> IntArray:
    """The points of every face, shape ``(f, c)``, filled with -1 where a face has fewer than ``c``."""
    text, line = _body(data, "faces")
    flat = integers(text.translate(_PUNCTUATION), line, "the file 'faces'")
    count = int(flat[0]) if len(flat) else 0
    if len(flat) == 1 + 5 * count and (flat[1::5] == 4).all():
        faces = flat[1:].reshape(count, 5)[:, 1:]
    else:
        starts, at = [], 1
        while at < len(flat) and flat[at] > 2:
            starts.append(at)
            at += 1 + int(flat[at])
        if len(starts) != count or at != len(flat):
            raise InputError("polyMesh: the list in 'faces' does not have the length that it tells", field="file")
        first = np.array(starts, dtype=np.int64)
        most = int(flat[first].max(initial=4))
        if most > MAX_CORNERS:
            raise InputError(f"polyMesh: a face has {most} points: {MAX_CORNERS} are possible", field="file")
        column = np.arange(most)
        inside = column < flat[first][:, None]
        faces = np.where(inside, flat[np.minimum(first[:, None] + 1 + column, len(flat) - 1)], -1)
        if (faces[inside] < 0).any():
            raise InputError("polyMesh: a face has a negative point", field="file")
        return faces
    if faces.min(initial=0) < 0:
        raise InputError("polyMesh: a face has a negative point", field="file")
    return faces


def _patches(data: bytes, faces: int) -> list[tuple[str, int, int]]:
    """The name, the first face and the number of faces of each patch."""
    found = []
    lists = [item for item in parse(data.decode("latin-1")).loose if isinstance(item, Items)]
    items = list(lists[0].items) if lists else []
    for name, entries in zip(items[::2], items[1::2], strict=False):
        if not (isinstance(name, Word) and isinstance(entries, Entries)):
            raise InputError("polyMesh: the file 'boundary' is no list of patches", field="file")
        numbers = []
        for key in ("startFace", "nFaces"):
            value = entries.values.get(key, [])
            if len(value) != 1 or not isinstance(value[0], Word):
                raise InputError(f"line {name.line} of 'boundary': the patch {name.text!r} has no {key}", field="file")
            numbers.append(value[0].integer())
        first, count = numbers
        if first < 0 or count < 0 or first + count > faces:
            message = f"line {name.line} of 'boundary': the patch {name.text!r} has faces that there are not"
            raise InputError(message, field="file")
        found.append((name.text.strip('"'), first, count))
    if sum(count for _, _, count in found) > faces:
        raise InputError("polyMesh: the patches in 'boundary' overlap: each face has one patch", field="file")
    return found


def _polygon(corners: int) -> str:
    return "triangle" if corners == 3 else f"polygon of {corners} corners"
