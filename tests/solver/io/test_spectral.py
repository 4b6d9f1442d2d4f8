"""Files of spectral element codes, read by readers that follow the public descriptions of these formats."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.io import write_mesh
from equimesh.io.spectral import INSIDE, MAX_LABELS, nmsh_bytes

SQUARE = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
BEND = em.Blocks.of(
    {
        "vertices": {name: [k % 3, k // 3] for k, name in enumerate("abcdefgh")},
        "blocks": [
            {"corners": ["a", "b", "e", "d"], "cells": [3, 4]},
            {"corners": ["f", "e", "b", "c"], "cells": [2, None]},  # upside down
            {"corners": ["d", "e", "h", "g"], "cells": [None, 2]},
        ],
        "sides": {"inlet": [["g", "h"]], "outlet": [["c", "f"]]},
    }
).mesh  # fmt: skip
MESHES = [pytest.param(SQUARE, id="grid"), pytest.param(BEND, id="blocks")]


def written(mesh: em.Mesh, path: Path) -> Path:
    owner = np.arange(len(mesh.cells)).reshape(mesh.cell_shape) // 8
    data = em.MeshData(mesh=mesh, q_eq=np.ones(mesh.cell_shape), u=None, subdomain=owner)
    (file,) = write_mesh(path, data)
    return file


def sides_of(mesh: em.Mesh, faces: list[tuple[int, int, str]]) -> dict[str, set[frozenset[int]]]:
    """The edges by the name of their side; a face is a cell, a local face and the name."""
    found: dict[str, set[frozenset[int]]] = {}
    for cell, face, name in faces:
        corners = mesh.cells[cell]
        found.setdefault(name, set()).add(frozenset((int(corners[face]), int(corners[(face + 1) % 4]))))
    return found


def own_sides(mesh: em.Mesh) -> dict[str, set[frozenset[int]]]:
    return {name: {frozenset(map(int, edge)) for edge in edges} for name, edges in mesh.sides.items()}


@pytest.mark.parametrize("mesh", MESHES)
def test_trixi_reads_the_corners_the_edges_and_the_names(mesh: em.Mesh, tmp_path: Path) -> None:
    lines = iter(written(mesh, tmp_path / "m.ism").read_text().splitlines())
    assert next(lines) == "ISM-V2"
    points, edges, cells, order = map(int, next(lines).split())
    assert (points, cells, order) == (len(mesh.points), len(mesh.cells), 1)
    at = np.array([next(lines).split()[:2] for _ in range(points)], dtype=float)
    np.testing.assert_array_equal(at, mesh.points)
    table = np.array([next(lines).split() for _ in range(edges)], dtype=int)
    corners, faces = [], []
    for cell in range(cells):
        corners.append(list(map(int, next(lines).split())))
        assert next(lines) == "0 0 0 0"
        names = next(lines).split()
        faces += [(cell, face, name) for face, name in enumerate(names) if name != INSIDE]
    assert list(lines) == []
    np.testing.assert_array_equal(np.array(corners) - 1, mesh.cells)
    assert sides_of(mesh, faces) == own_sides(mesh)
    # Every edge stands once, with both cells, and as the faces run: 1 and 3 to the right, 2 and 4 upwards.
    forward = {1: (0, 1), 2: (1, 2), 3: (3, 2), 4: (0, 3)}
    seen = set()
    for start, end, left, right, face, other in table.tolist():
        assert [corners[left - 1][k] for k in forward[face]] == [start, end]
        seen.add((left, face))
        if right == 0:
            assert other == 0
            continue
        ends = [corners[right - 1][k] for k in forward[abs(other)]]
        assert ends == ([start, end] if other > 0 else [end, start])
        seen.add((right, abs(other)))
    assert len(seen) == 4 * cells
    assert (table[:, 3] == 0).sum() == sum(map(len, mesh.sides.values()))
    assert mesh.is_grid or (table[:, 5] < 0).any()  # the turned block


@pytest.mark.parametrize("mesh", MESHES)
def test_nek5000_reads_the_corners_and_the_numbers_of_the_sides(mesh: em.Mesh, tmp_path: Path) -> None:
    data = written(mesh, tmp_path / "m.re2").read_bytes()
    version, cells, dimension, fluid = data[:80].split()[:4]
    assert (version, int(cells), int(dimension), int(fluid)) == (b"#v002", len(mesh.cells), 2, len(mesh.cells))
    assert struct.unpack("<f", data[80:84])[0] == pytest.approx(6.54321)
    end = 84 + 72 * len(mesh.cells)
    corners = np.frombuffer(data[84:end], "<f8").reshape(-1, 9)[:, 1:].reshape(-1, 2, 4)
    np.testing.assert_array_equal(corners.swapaxes(1, 2), mesh.points[mesh.cells])
    curved, conditions = struct.unpack("<dd", data[end : end + 16])
    rows = np.frombuffer(
        data[end + 16 :], np.dtype([("cell", "<f8"), ("face", "<f8"), ("more", "<f8", 5), ("kind", "S8")])
    )
    assert (curved, conditions) == (0, len(rows))
    assert {*rows["kind"]} == {b"MSH     "}
    assert not rows["more"][:, :4].any()
    names = [*mesh.sides]
    faces = [(int(row["cell"]) - 1, int(row["face"]) - 1, names[int(row["more"][4]) - 1]) for row in rows]
    assert sides_of(mesh, faces) == own_sides(mesh)


@pytest.mark.parametrize("mesh", MESHES)
def test_neko_reads_the_nodes_and_the_labelled_zones(mesh: em.Mesh, tmp_path: Path) -> None:
    data = written(mesh, tmp_path / "m.nmsh").read_bytes()
    count, dimension = struct.unpack("<ii", data[:8])
    assert (count, dimension) == (len(mesh.cells), 2)
    place = 8
    for cell in range(count):
        assert struct.unpack_from("<i", data, place) == (cell + 1,)
        for corner in range(4):
            node, x, y, z = struct.unpack_from("<iddd", data, place + 4 + 28 * corner)
            assert node - 1 == mesh.cells[cell, corner]
            assert (x, y, z) == (*mesh.points[node - 1], 0.0)
        place += 116
    (zones,) = struct.unpack_from("<i", data, place)
    faces, names = [], [*mesh.sides]
    own = {3: 0, 2: 1, 4: 2, 1: 3}  # Neko: 1 left, 2 right, 3 bottom, 4 top
    for number in range(zones):
        cell, face, _, label, *_, kind = struct.unpack_from("<9i", data, place + 4 + 36 * number)
        assert kind == 7
        faces.append((cell - 1, own[face], names[label - 1]))
    assert sides_of(mesh, faces) == own_sides(mesh)
    assert data[place + 4 + 36 * zones :] == b"\0\0\0\0"  # no curved element


def test_neko_knows_no_more_than_20_sides() -> None:
    sides = {f"side{k}": SQUARE.sides["top"][:1] for k in range(MAX_LABELS + 1)}
    with pytest.raises(em.InputError, match="Neko knows 20 sides, and this mesh has 21: give some of them one name"):
        nmsh_bytes(SQUARE.points, SQUARE.cells, sides)


@pytest.mark.parametrize("mesh", MESHES)
def test_specfem_reads_the_nodes_and_the_surfaces(mesh: em.Mesh, tmp_path: Path) -> None:
    with zipfile.ZipFile(written(mesh, tmp_path / "m.specfem.zip")) as archive:
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    assert [*texts] == [
        "mesh_file",
        "nodes_coords_file",
        "materials_file",
        "free_surface_file",
        "absorbing_surface_file",
    ]
    np.testing.assert_array_equal(table(texts["mesh_file"], 4) - 1, mesh.cells)
    np.testing.assert_array_equal(table(texts["nodes_coords_file"], 2, float), mesh.points)
    assert [*map(int, texts["materials_file"].split())] == [k // 8 + 1 for k in range(len(mesh.cells))]
    free, absorbing = table(texts["free_surface_file"], 4), table(texts["absorbing_surface_file"], 5)
    wanted = own_sides(mesh)
    assert {frozenset(row[2:] - 1) for row in free} == wanted.pop("top", set())
    assert {frozenset(row[2:4] - 1) for row in absorbing} == set().union(*wanted.values())
    for cell, count, first, second, *_ in [*free.tolist(), *absorbing.tolist()]:
        assert count == 2
        assert {first - 1, second - 1} <= {*mesh.cells[cell - 1].tolist()}
    middle = mesh.points[absorbing[:, 2:4] - 1].mean(axis=1)
    if mesh.is_grid:
        np.testing.assert_array_equal(middle[absorbing[:, 4] == 1][:, 1], 0.0)
        np.testing.assert_array_equal(middle[absorbing[:, 4] == 2][:, 0], 1.0)
        np.testing.assert_array_equal(middle[absorbing[:, 4] == 4][:, 0], 0.0)
    else:
        np.testing.assert_array_equal(middle[absorbing[:, 4] == 1][:, 1], 0.0)
        assert {*absorbing[:, 4]} == {1, 2, 3, 4}


RING = em.solve(
    em.Problem(monitor=em.ArcLength(u=em.Expression("x + y")), grid=em.Grid(n_xi=4, n_eta=5), domain=em.AnnulusSector())
)


def on_arcs(points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Which points lie on the inner or the outer arc of the sector."""
    radius = np.hypot(points[:, 0], points[:, 1])
    on: np.ndarray[Any, Any] = (abs(radius - 1.0) < 1e-12) | (abs(radius - 2.0) < 1e-12)
    return on


def test_trixi_reads_curves_through_the_middles_of_curved_sides(tmp_path: Path) -> None:
    (file,) = RING.write(tmp_path / "m.ism", order=2)
    lines = iter(file.read_text().splitlines()[1:])
    points, edges, cells, order = map(int, next(lines).split())
    assert (points, order) == (20, 2)
    at = np.array([next(lines).split()[:2] for _ in range(points)], dtype=float)
    for _ in range(edges):
        next(lines)
    forward = [(0, 1), (1, 2), (3, 2), (0, 3)]
    found = 0
    for _ in range(cells):
        corners = np.array(next(lines).split(), dtype=int) - 1
        for (first, last), flag in zip(forward, map(int, next(lines).split()), strict=True):
            if flag:
                curve = np.array([next(lines).split()[:2] for _ in range(3)], dtype=float)
                np.testing.assert_array_equal(curve[[0, 2]], at[corners[[first, last]]])
                assert on_arcs(curve).all()
                found += 1
        assert len(next(lines).split()) == 4
    assert found == 2 * 4  # the edges of both arcs, and no others


def test_nek5000_reads_the_middles_of_curved_sides(tmp_path: Path) -> None:
    (file,) = RING.write(tmp_path / "m.re2", order=2)
    data, end = file.read_bytes(), 84 + 72 * 12
    (count,) = struct.unpack("<d", data[end : end + 8])
    assert count == 8
    rows = np.frombuffer(data[end + 8 : end + 8 + 64 * 8], np.dtype([("numbers", "<f8", 7), ("kind", "S8")]))
    assert {*rows["kind"]} == {b"m       "}
    assert on_arcs(rows["numbers"][:, 2:4]).all()
    for cell, face, x, y, *more in rows["numbers"].tolist():
        ends = RING.mesh.cells[int(cell) - 1][[int(face) - 1, int(face) % 4]]
        assert np.hypot(*(RING.mesh.points[ends].mean(axis=0) - (x, y))) < 0.1
        assert more == [0.0, 0.0, 0.0]
    (conditions,) = struct.unpack("<d", data[end + 8 + 64 * 8 :][:8])
    assert conditions == 2 * (3 + 4)


def test_specfem_reads_cells_of_nine_nodes(tmp_path: Path) -> None:
    (file,) = RING.write(tmp_path / "m.specfem.zip", order=2)
    with zipfile.ZipFile(file) as archive:
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    cells, at = table(texts["mesh_file"], 9) - 1, table(texts["nodes_coords_file"], 2, float)
    np.testing.assert_array_equal(cells[:, :4], RING.mesh.cells)
    for face in range(4):
        ends = at[cells[:, [face, (face + 1) % 4]]].mean(axis=1)
        assert np.hypot(*(at[cells[:, 4 + face]] - ends).T).max() < 0.1
    assert {frozenset(row[2:] - 1) for row in table(texts["free_surface_file"], 4)} == own_sides(RING.mesh)["top"]


def table(text: str, columns: int, kind: Any = int) -> np.ndarray[Any, Any]:
    """The rows behind their number."""
    count, *values = text.split()
    rows = np.array([*map(kind, values)]).reshape(-1, columns)
    assert len(rows) == int(count)
    return rows


@pytest.mark.parametrize("suffix", [".ism", ".re2", ".nmsh", ".specfem.zip"])
def test_triangles_are_refused(suffix: str, tmp_path: Path) -> None:
    data = em.MeshData(mesh=SQUARE, q_eq=np.ones((4, 3)), u=None, subdomain=np.zeros((4, 3), dtype=int))
    with pytest.raises(em.InputError, match="file holds no triangles"):
        write_mesh(tmp_path / f"m{suffix}", data, cells="triangle")
