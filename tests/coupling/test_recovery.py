"""Values at the nodes from averages over cells."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh import Mesh
from equimesh_coupling import BadValues, CellAverages
from equimesh_coupling.recovery import nodes_from_cells


def centroids(mesh: Mesh, cells: str) -> np.ndarray:
    """The centroids of the cells, by a fan of triangles."""
    parts = mesh.mesh_parts(cells)  # type: ignore[arg-type]
    corners = parts.points[parts.cells]
    fans = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
    areas = np.stack([np.linalg.det(fan[:, 1:] - fan[:, :1]) for fan in fans])
    return (areas[..., None] * np.stack([fan.mean(axis=1) for fan in fans])).sum(axis=0) / areas.sum(axis=0)[:, None]


@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_a_linear_function_is_recovered_without_error(mesh: Mesh, cells: str) -> None:
    x, y = centroids(mesh, cells).T
    found = nodes_from_cells(CellAverages(2 + 3 * x - 5 * y), mesh)
    assert abs(found - (2 + 3 * mesh.x - 5 * mesh.y)).max() < 1e-12


def test_a_smooth_function_is_recovered_to_second_order() -> None:
    errors = []
    for n in (17, 33, 65):
        xi, eta = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
        mesh = Mesh(xi + 0.1 * np.sin(3 * eta), eta + 0.2 * xi**2)
        x, y = centroids(mesh, "quad").T
        errors.append(abs(nodes_from_cells(CellAverages(np.sin(3 * x) * y**2), mesh) - np.sin(3 * mesh.x) * mesh.y**2))
    largest = [error.max() for error in errors]
    assert largest[0] / largest[1] > 3.5
    assert largest[1] / largest[2] > 3.5
    assert largest[2] < 2e-3


def test_thin_cells_do_no_harm() -> None:
    s = np.linspace(0, 1, 9) ** 6
    mesh = Mesh(*np.meshgrid(s, s, indexing="ij"))
    x, y = centroids(mesh, "quad").T
    assert abs(nodes_from_cells(CellAverages(x - y), mesh) - (mesh.x - mesh.y)).max() < 1e-12


def test_two_rows_of_cells_are_needed() -> None:
    mesh = Mesh(*np.meshgrid([0.0, 1.0], [0.0, 0.5, 1.0], indexing="ij"))
    with pytest.raises(BadValues, match="at least 3 nodes on each side"):
        nodes_from_cells(CellAverages([1.0, 2.0]), mesh)
