"""The files of an OpenFOAM mesh, ``constant/polyMesh``: the plane mesh, one cell thick along z."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.io.integer_rows import integer_rows
from equimesh.io.side_names import words
from equimesh.meshes.joins import Join
from equimesh.numerics.types import Array

IntArray: TypeAlias = npt.NDArray[np.integer[Any]]

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
        "faces": _file("faceList", "faces", [*_rows(walls), *_rows(plane)]),
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


def _rows(faces: IntArray) -> list[str]:
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
