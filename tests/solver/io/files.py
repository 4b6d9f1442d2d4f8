"""A mesh that is written in every format, and what must be read back of it: nodes, cells, edges of the sides, data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.io.write import FORMATS, Cells, MeshData, write_mesh
from equimesh.meshes.mesh import Mesh

N_XI, N_ETA = 7, 5


CELL_COUNT = (N_XI - 1) * (N_ETA - 1)


EDGES = {"left": N_ETA - 1, "right": N_ETA - 1, "bottom": N_XI - 1, "top": N_XI - 1}


KINDS: tuple[Cells, ...] = ("quad", "triangle")


READS_TAGS = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (1, 0.0), "top": (1, 1.0)}


def adapted(n_xi: int = N_XI, n_eta: int = N_ETA) -> MeshData:
    """A curved mesh of the unit square with data that tells every node and cell apart."""
    xi, eta = np.meshgrid(np.linspace(0, 1, n_xi), np.linspace(0, 1, n_eta), indexing="ij")
    bump = 0.12 * np.sin(np.pi * xi) * np.sin(np.pi * eta)
    cells = (n_xi - 1, n_eta - 1)
    return MeshData(
        mesh=Mesh(np.sqrt(xi) + bump * (1 - xi), eta**1.5 - bump * eta),
        u=np.cos(5 * xi) + 0.1 * eta,
        q_eq=1 + np.arange(np.prod(cells)).reshape(cells) / 7,
        subdomain=np.arange(np.prod(cells), dtype=np.int64).reshape(cells) // 11,
    )


DATA = adapted()


def per_cell(values: np.ndarray, kind: str) -> np.ndarray:
    return np.repeat(values.ravel(), 2 if kind == "triangle" else 1)


def areas(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Signed areas of polygons."""
    x, y = points[cells, 0], points[cells, 1]
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)


def check_cells(points: np.ndarray, cells: np.ndarray, kind: str) -> None:
    assert cells.shape == ((CELL_COUNT, 4) if kind == "quad" else (2 * CELL_COUNT, 3))
    found = areas(points, cells)
    assert np.all(found > 0)
    assert found.sum() == pytest.approx(1)
    quads = areas(points, DATA.mesh.cells)
    np.testing.assert_allclose(found if kind == "quad" else found.reshape(-1, 2).sum(axis=1), quads, rtol=1e-12)


def check_edges(points: np.ndarray, edges: np.ndarray, side: str) -> None:
    """The edges lie on the side, join up to all of it, and have the domain on their left."""
    axis, at = READS_TAGS[side]
    assert edges.shape == (EDGES[side], 2)
    assert np.all(points[edges][:, :, axis] == at)
    direction = points[edges[:, 1]] - points[edges[:, 0]]
    assert np.abs(direction[:, 1 - axis]).sum() == pytest.approx(1)
    inwards = np.array([-direction[:, 1], direction[:, 0]])[axis]
    assert np.all(inwards * (1 if at == 0 else -1) > 0)


def check_mesh(found: Any, kind: str, *, dimension: int) -> None:
    """What meshio read against what was written."""
    assert found.points.shape == (N_XI * N_ETA, dimension)
    np.testing.assert_array_equal(found.points[:, :2], DATA.mesh.points)
    assert np.all(found.points[:, 2:] == 0)
    assert [block.type for block in found.cells] == [kind]
    check_cells(found.points, found.cells[0].data, kind)
    xi, eta = DATA.computational
    assert sorted(found.point_data) == ["eta", "u", "xi"]
    for name, values in (("u", DATA.u), ("xi", xi), ("eta", eta)):
        np.testing.assert_array_equal(np.ravel(found.point_data[name]), values.ravel())
    assert sorted(found.cell_data) == ["Q_eq", "subdomain"]
    np.testing.assert_array_equal(np.ravel(found.cell_data["Q_eq"][0]), per_cell(DATA.q_eq, kind))
    np.testing.assert_array_equal(np.ravel(found.cell_data["subdomain"][0]), per_cell(DATA.subdomain, kind))
    for side, (axis, at) in READS_TAGS.items():  # the sides can be found by xi and eta
        nodes = np.unique(DATA.mesh.sides[side])
        np.testing.assert_array_equal(np.flatnonzero(np.ravel(found.point_data[("xi", "eta")[axis]]) == at), nodes)


def written(folder: Path, name: str, kind: Cells) -> Path:
    """The mesh in a file of the format ``name``."""
    path = folder / f"mesh{FORMATS[name].suffix}"
    assert write_mesh(path, DATA, format=name, cells=kind) == (path,)
    return path
