"""Mesh files of spectral element codes, which take quadrilaterals alone: Trixi, Nek5000, Neko, SPECFEM2D.

All functions take the ``points``, shape ``(n, 2)``, the ``cells``, ``(m, 4)``, counter-clockwise, and the ``sides``,
``(k, 2)`` each, with the domain on their left. Cells of second order have the shape ``(m, 9)``: the corners, the
middles of the edges, the centre; their sides ``(k, 3)``, the middle last; all corners come first among the points.
Numbers start at 0, and at 1 in the files. Face j of a cell goes from corner j to the next; the first one is called its
bottom, then right, top and left.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from equimesh.errors import InputError
from equimesh.io.abaqus import faces_of
from equimesh.io.solver_files import integer_rows, words
from equimesh.numerics.types import Array, BoolArray, IntArray

INSIDE = "---"
"""The name of an edge inside the domain in a HOHQMesh file."""
MAX_STRAIGHT = 1e-12
"""An edge is straight whose middle is no further, in lengths of the edge, from the mean of its ends."""
FORWARD = np.array([[0, 1], [1, 2], [3, 2], [0, 3]])
"""The first and the last corner of each face in a HOHQMesh file: opposite faces run the same way."""
RE2_HEADER = 80
"""Characters of the header of a re2 file."""
RE2_TAG = 6.54321
"""The number by which readers of a re2 file know the order of its bytes."""
RE2_ROW = np.dtype([("numbers", "<f8", 7), ("kind", "S8")])
"""A row of a re2 file: a cell, a face, five numbers, and what they are."""
MIDDLE = b"m       "
"""The curve of Nek5000 that is given by its middle."""
MESH_SIDE = b"MSH     "
"""The condition of Nek5000 that means: see the number of the side."""
NEKO_FACES = np.array([3, 2, 4, 1])
"""Neko's numbers of the bottom, right, top and left face."""
LABELLED = 7
"""Neko's type of a zone that has a number of its own."""
MAX_LABELS = 20
"""Neko's largest number of a zone."""
TOP = "top"
"""The side that is the free surface for SPECFEM2D."""


def hohqmesh_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray]) -> str:
    """The text of a mesh file of HOHQMesh, version ISM-V2; sides keep their names.

    Edges of cells of second order that are not straight are curves through three points.

    Source: HOHQMesh, "The HOHQMesh mesh file formats".
    """
    corners, is_curved = cells[:, :4], _curved_faces(points, cells)
    edges, names = _ism_edges(corners), _ism_names(corners, sides)
    nodes = points if cells.shape[1] == 4 else points[: int(corners.max()) + 1]
    lines = ["ISM-V2", f"{len(nodes)} {len(edges)} {len(cells)} {1 if cells.shape[1] == 4 else 2}"]
    lines += _ism_points(nodes)
    lines += integer_rows("%d %d %d %d %d %d", edges)
    for cell, of_faces, curved in zip(cells, names, is_curved, strict=True):
        lines += [" ".join(map(str, (cell[:4] + 1).tolist())), " ".join(map(str, curved.astype(int).tolist()))]
        for face in np.flatnonzero(curved).tolist():
            first, last = FORWARD[face]
            lines += _ism_points(points[cell[[first, 4 + face, last]]])
        lines.append(" ".join(of_faces))
    return "\n".join(lines) + "\n"


def _ism_points(points: Array) -> list[str]:
    return [f"{x!r} {y!r} 0.0" for x, y in points.tolist()]


def _curved_faces(points: Array, cells: IntArray) -> BoolArray:
    """Which faces of each cell are not straight, shape ``(m, 4)``."""
    if cells.shape[1] == 4:
        return np.zeros((len(cells), 4), dtype=bool)
    ends = points[cells[:, :4]], points[np.roll(cells[:, :4], -1, axis=1)]
    away = np.linalg.norm(points[cells[:, 4:8]] - 0.5 * (ends[0] + ends[1]), axis=2)
    curved: BoolArray = away > MAX_STRAIGHT * np.linalg.norm(ends[1] - ends[0], axis=2)
    return curved


def _ism_edges(cells: IntArray) -> IntArray:
    """One row for each edge: its two nodes, the cells and the faces at its sides, shape ``(edges, 6)``.

    The nodes run as the face of the first cell does. The second cell and face are 0 on the boundary; the second face is
    negative where it runs the other way.
    """
    ends = cells[:, FORWARD].reshape(-1, 2)
    keys = ends.min(axis=1) * (int(cells.max()) + 1) + ends.max(axis=1)
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    ones = order[first]
    pairs = np.diff(first, append=len(order)) == 2
    others = order[np.minimum(first + 1, len(order) - 1)]
    one_cell, one_face = np.divmod(ones, 4)
    other_cell, other_face = np.divmod(others, 4)
    same = (ends[ones] == ends[others]).all(axis=1)
    found: IntArray = np.column_stack(
        [
            ends[ones] + 1,
            one_cell + 1,
            np.where(pairs, other_cell + 1, 0),
            one_face + 1,
            np.where(pairs, np.where(same, 1, -1) * (other_face + 1), 0),
        ]
    )
    return found


def _ism_names(cells: IntArray, sides: Mapping[str, IntArray]) -> list[list[str]]:
    """The names of the four faces of each cell."""
    named = words(sides, [INSIDE])
    found = [[INSIDE] * 4 for _ in range(len(cells))]
    for side, edges in sides.items():
        for cell, face in faces_of(cells, edges[:, :2]).tolist():
            found[cell][face] = named[side]
    return found


def re2_bytes(points: Array, cells: IntArray, sides: Mapping[str, IntArray]) -> bytes:
    """The bytes of a mesh of Nek5000, version #v002. Curved edges of cells of second order have their middle, ``m``.

    The faces of a side have the condition ``MSH`` and the number of the side, from 1, as the fifth parameter, from
    which Nek5000 has ``boundaryID``.

    Source: the reader of Nek5000, and that of pymech.
    """
    count = len(cells)
    header = f"#v002{count:9d}{2:3d}{count:9d} this is the hdr".ljust(RE2_HEADER).encode("ascii")
    corners = np.zeros((count, 9))
    corners[:, 1:] = points[cells[:, :4]].swapaxes(1, 2).reshape(count, 8)
    bent = np.argwhere(_curved_faces(points, cells))
    curves = np.zeros(len(bent), dtype=RE2_ROW)
    curves["numbers"][:, :2] = bent + 1
    if len(bent):
        curves["numbers"][:, 2:4] = points[cells[bent[:, 0], 4 + bent[:, 1]]]
    curves["kind"] = MIDDLE
    faces = _numbered(cells[:, :4], sides)
    conditions = np.zeros(len(faces), dtype=RE2_ROW)
    conditions["numbers"][:, :2] = faces[:, :2] + 1
    conditions["numbers"][:, 6] = faces[:, 2]
    conditions["kind"] = MESH_SIDE
    parts = [header, np.array([RE2_TAG], dtype="<f4").tobytes(), corners.astype("<f8").tobytes()]
    for rows in (curves, conditions):
        parts += [np.array([len(rows)], dtype="<f8").tobytes(), rows.tobytes()]
    return b"".join(parts)


def nmsh_bytes(points: Array, cells: IntArray, sides: Mapping[str, IntArray]) -> bytes:
    """The bytes of a mesh of Neko in two dimensions, with straight edges; sides are zones with numbers, from 1.

    Raises :class:`~equimesh.errors.InputError` for more than ``MAX_LABELS`` sides.

    Source: Neko, ``src/io/format/nmsh.f90`` and ``src/io/nmsh_file.f90``.
    """
    if len(sides) > MAX_LABELS:
        message = f"Neko knows {MAX_LABELS} sides, and this mesh has {len(sides)}: give some of them one name"
        raise InputError(message, field="format")
    quads = np.zeros(len(cells), dtype=[("number", "<i4"), ("corners", [("node", "<i4"), ("at", "<f8", 3)], 4)])
    quads["number"] = np.arange(1, len(cells) + 1)
    quads["corners"]["node"] = cells + 1
    quads["corners"]["at"][..., :2] = points[cells]
    faces = _numbered(cells, sides)
    zones = np.zeros((len(faces), 9), dtype="<i4")  # cell, face, -, number, nodes of a periodic face, type
    zones[:, 0], zones[:, 1] = faces[:, 0] + 1, NEKO_FACES[faces[:, 1]]
    zones[:, 3], zones[:, 8] = faces[:, 2], LABELLED
    size, count, curves = (np.array(one, dtype="<i4").tobytes() for one in ([len(cells), 2], len(faces), 0))
    return b"".join([size, quads.tobytes(), count, zones.tobytes(), curves])


def specfem_files(
    points: Array, cells: IntArray, sides: Mapping[str, IntArray], *, subdomain: IntArray
) -> dict[str, str]:
    """The texts of the files of an external mesh of SPECFEM2D, by their names in its ``Par_file``.

    The side ``top`` is the free surface; all others absorb, each edge as the bottom, right, top or left of the model by
    the direction of its outward normal. The material of a cell is its subdomain, from 1.

    Source: SPECFEM2D, ``src/meshfem2D/read_external_mesh_files.F90``.
    """
    free, absorbing = list[IntArray](), list[IntArray]()
    for side, edges in sides.items():
        along = points[edges[:, 1]] - points[edges[:, 0]]
        out = np.column_stack([along[:, 1], -along[:, 0]])
        is_level = abs(out[:, 0]) > abs(out[:, 1])
        towards = np.where(is_level, np.where(out[:, 0] > 0.0, 2, 4), np.where(out[:, 1] > 0.0, 3, 1))
        cell = faces_of(cells[:, :4], edges[:, :2])[:, 0]
        rows = np.column_stack([cell + 1, np.full(len(edges), 2), edges[:, :2] + 1, towards])
        (free if side == TOP else absorbing).append(rows[:, :4] if side == TOP else rows)
    return {
        "mesh_file": _counted(" ".join(["%d"] * cells.shape[1]), cells + 1),
        "nodes_coords_file": "\n".join([str(len(points)), *(f"{x!r} {y!r}" for x, y in points.tolist()), ""]),
        "materials_file": "\n".join([*map(str, (subdomain.ravel() + 1).tolist()), ""]),
        "free_surface_file": _counted("%d %d %d %d", _joined(free, 4)),
        "absorbing_surface_file": _counted("%d %d %d %d %d", _joined(absorbing, 5)),
    }


def _counted(form: str, rows: IntArray) -> str:
    return "\n".join([str(len(rows)), *integer_rows(form, rows), ""])


def _joined(rows: list[IntArray], columns: int) -> IntArray:
    return np.concatenate([np.empty((0, columns), dtype=np.int64), *rows])


def _numbered(cells: IntArray, sides: Mapping[str, IntArray]) -> IntArray:
    """The cell, the face and the number of the side, from 1, of all edges of the sides, shape ``(k, 3)``."""
    rows = [
        np.column_stack([faces_of(cells, edges[:, :2]), np.full(len(edges), number)])
        for number, edges in enumerate(sides.values(), start=1)
    ]
    return _joined(rows, 3)
