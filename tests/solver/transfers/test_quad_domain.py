"""Whether two meshes of blocks are ones of one domain."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.cell_edges import links_of
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.transfers.one_domain import boundary_of, in_loops, require_one_domain, require_valid_quads
from solver.meshes.quad_cases import bent, corner, disc, ring, strip, turned


def test_meshes_of_one_domain_pass() -> None:
    require_one_domain(corner(4), bent(corner(7), 0.01))
    require_one_domain(ring(5), turned(ring(6), 0.02))
    require_one_domain(strip(6), strip(6, 0.3, 0.02))


@pytest.mark.parametrize("other", [disc(4), corner(4).moved(1.001 * corner(4).points), turned(corner(4), 0.01)])
def test_meshes_of_two_domains_are_refused_with_a_node(other: QuadMesh) -> None:
    with pytest.raises(em.InputError, match=r"the node at \(.*\) of a side of one mesh does not lie"):
        require_one_domain(corner(4), other)


def test_a_corner_is_no_curve() -> None:
    mesh = corner(2)
    cut = mesh.points.copy()
    cut[np.argmax(mesh.points.sum(axis=1) * (mesh.y < 1.5) * (mesh.x > 1.5))] -= 0.05  # the corner (2, 1)
    with pytest.raises(em.InputError, match=r"\(1.95, 0.95\)"):
        require_one_domain(mesh, mesh.moved(cut))


def test_a_grid_and_blocks_are_of_two_kinds() -> None:
    grid = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    with pytest.raises(em.InputError, match="two meshes of one kind"):
        require_one_domain(grid, QuadMesh(points=grid.points, cells=grid.cells, sides=grid.sides))


def test_a_folded_mesh_is_refused() -> None:
    points = corner(3).points.copy()
    points[[0, 5]] = points[[5, 0]]
    with pytest.raises(em.InputError, match="folded"):
        require_valid_quads(corner(3).moved(points))


def test_edges_follow_each_other_around_each_loop() -> None:
    mesh = ring(3)
    links = links_of(mesh.cells, len(mesh.points))
    edges = in_loops(links, links.boundary())
    begin, end = (mesh.cells[edges // 4, (edges + step) % 4] for step in (0, 1))
    assert (end[:-1] == begin[1:]).sum() == 24 - 2
    points, found = boundary_of(mesh)
    assert points.shape == (24, 2)
    assert found[:, 4] == pytest.approx(np.hypot(*(found[:, 2:4] - found[:, :2]).T) * np.pi / 6)
    assert boundary_of(strip(4))[1].shape == (3 * 8, 5)
