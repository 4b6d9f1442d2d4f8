"""A mesh with its data: shapes that must agree, and cells cut into triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from block_cases import data_of, l_shape
from equimesh.errors import InputError
from equimesh.io.write import MeshData
from equimesh.meshes.mesh import Mesh
from solver.io.files import DATA, adapted, areas


class TestTriangles:
    def test_no_triangle_has_two_edges_on_the_boundary(self) -> None:
        data = adapted(6, 5)
        edges = {tuple(sorted(edge)) for side in data.mesh.sides.values() for edge in side.tolist()}
        for row in data.triangles().tolist():
            assert sum(tuple(sorted((row[k], row[k - 1]))) in edges for k in range(3)) < 2

    @staticmethod
    def data(*corners: tuple[float, float]) -> MeshData:
        """One cell of interest, the middle one of nine, with the given corners counter-clockwise."""
        x, y = (a.copy() for a in np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij"))
        for (i, j), (px, py) in zip(((1, 1), (2, 1), (2, 2), (1, 2)), corners, strict=True):
            x[i, j], y[i, j] = px, py
        return MeshData(mesh=Mesh(x, y), u=x, q_eq=np.ones((3, 3)), subdomain=np.zeros((3, 3), dtype=np.int64))

    def first(self, *corners: tuple[float, float]) -> list[list[int]]:
        return [sorted(t) for t in self.data(*corners).triangles()[8:10].tolist()]

    def test_the_larger_smallest_angle_wins(self) -> None:
        main, other = [[5, 9, 10], [5, 6, 10]], [[5, 6, 9], [6, 9, 10]]
        assert self.first((0, 0), (1, 0), (1.6, 1.6), (0, 1)) == other
        assert self.first((0.4, 0.4), (1, -0.5), (1, 1), (-0.5, 1)) == main

    def test_an_even_cell_is_cut_from_its_first_corner(self) -> None:
        assert self.first((0, 0), (1, 0), (1, 1), (0, 1)) == [[5, 9, 10], [5, 6, 10]]
        data = adapted(18, 18)
        xi, eta = data.computational
        turned = Mesh(np.cos(0.3) * xi - np.sin(0.3) * eta, np.sin(0.3) * xi + np.cos(0.3) * eta)  # even up to rounding
        even = MeshData(mesh=turned, u=data.u, q_eq=data.q_eq, subdomain=data.subdomain)
        first = even.triangles().reshape(-1, 2, 3)[:, :, 0]
        corners = [0, 16, 16 * 17, 17 * 17 - 1]
        expected = np.repeat(turned.cells[:, :1], 2, axis=1)
        np.testing.assert_array_equal(np.delete(first, corners, axis=0), np.delete(expected, corners, axis=0))

    def test_a_dented_cell_keeps_both_triangles_positive(self) -> None:
        for dent in range(4):
            corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
            x, y = corners[dent]
            corners[dent] = (x + 0.6 * (1 - 2 * x), y + 0.6 * (1 - 2 * y))  # beyond the middle
            data = self.data(*corners)
            assert np.all(areas(data.mesh.points, data.triangles()[8:10]) > 0)

    def test_two_for_each_cell_in_order(self) -> None:
        pairs = DATA.triangles().reshape(-1, 6)
        for pair, quad in zip(pairs, DATA.mesh.cells, strict=True):
            assert set(pair) == set(quad)


def test_wrong_shapes() -> None:
    with pytest.raises(InputError, match=r"q_eq has shape \(7, 5\), this mesh needs \(6, 4\)"):
        MeshData(mesh=DATA.mesh, u=DATA.u, q_eq=DATA.u, subdomain=DATA.subdomain)
    with pytest.raises(InputError, match=r"the field rho has shape \(7, 5\), this mesh needs \(6, 4\)"):
        replace(DATA, cell_fields={"rho": DATA.u})
    with pytest.raises(InputError, match=r"the field v has shape \(7, 5, 2, 1\)"):
        replace(DATA, fields={"v": np.zeros((7, 5, 2, 1))})


def test_blocks_have_one_value_for_each_node_and_cell() -> None:
    data = data_of(l_shape())
    with pytest.raises(InputError, match=r"q_eq has shape \(65,\), this mesh needs \(48,\)"):
        replace(data, q_eq=data.u)
    with pytest.raises(InputError, match=r"the field way has shape \(48, 2, 1\), this mesh needs \(48,\)"):
        replace(data, cell_fields={"way": np.zeros((48, 2, 1))})
    for needs_a_grid in ("computational", "grid_mesh"):
        with pytest.raises(InputError, match="this needs a grid, and a mesh of blocks has no rows and columns"):
            getattr(data, needs_a_grid)
    assert DATA.grid_mesh is DATA.mesh
