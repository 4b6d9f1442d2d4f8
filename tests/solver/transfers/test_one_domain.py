"""Meshes of one domain, and of two."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import links_of
from equimesh.meshes.mesh import Mesh
from equimesh.transfers.one_domain import (
    boundary_of,
    first_beyond,
    in_loops,
    require_one_domain,
    require_valid,
)
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, ring, strip, turned

RING = em.AnnulusSector(radii=(1.0, 2.0), angles=(0, 180))


@pytest.mark.parametrize(
    "domain",
    [
        em.Rectangle(x=(100.0, 103.0), y=(-1.0, 1.0)),
        RING,
        em.AnnulusSector(angles=(0, 360)),
        em.Quadrilateral(
            bottom=em.Curve.of_expressions("t", "0.2*sin(6*t)*(1 - t)"),
            right=em.Curve.through([[1.0, 0.0], [1.3, 0.5], [1.0, 1.0]]),
            top=em.Curve.through([[0.0, 1.0], [1.0, 1.0]]),
            left=em.Curve.through([[0.0, 0.0], [0.0, 1.0]]),
        ),
    ],
)
def test_meshes_of_one_domain_pass(domain: em.Domain) -> None:
    for one, other in ((12, 16), (33, 12), (17, 17)):
        pair = smooth_mesh(one, depth=0.05), smooth_mesh(other, depth=-0.03)
        require_one_domain(*(map_mesh(em.Mesh.of_unit_square(m.x, m.y), domain) for m in pair))


def test_the_way_of_numbering_does_not_matter() -> None:
    old, new = smooth_mesh(9), smooth_mesh(12)
    require_one_domain(old, em.Mesh(1.0 - new.y, new.x.copy()))


def test_a_ring_of_a_slightly_larger_radius_is_another_domain() -> None:
    old, new = (map_mesh(em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)), RING) for _ in range(2))
    require_one_domain(old, new)
    with pytest.raises(InputError, match="of one domain"):
        require_one_domain(old, em.Mesh(1.02 * new.x, 1.02 * new.y))


def test_the_part_of_a_mesh_is_another_domain() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    part = em.Mesh(mesh.x[:5], mesh.y[:5])
    for pair in ((mesh, part), (part, mesh)):
        with pytest.raises(InputError, match="of one domain"):
            require_one_domain(*pair)


def test_a_mesh_of_few_nodes_is_not_valid() -> None:
    mesh = smooth_mesh(4)
    require_valid(mesh)
    with pytest.raises(InputError, match=r"a mesh is needed, .* not the text 'x'"):
        require_valid("x")
    with pytest.raises(InputError, match="a mesh has 3 x 7 nodes"):
        require_valid(em.Mesh(mesh.x[:3], mesh.y[:3]))


def test_the_first_point_that_is_too_far_is_found() -> None:
    edges = np.array([[0.0, 0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 1.0, 0.1]])
    points = np.array([[0.5, 0.0], [1.05, 0.5], [0.5, 0.05]])
    assert first_beyond(points[:2], edges, 1e-9) == -1
    assert first_beyond(points, edges, 1e-9) == 2
    assert first_beyond(points, edges, 0.06) == -1


# Whether two meshes of blocks are ones of one domain.


def test_blocks_of_one_domain_pass() -> None:
    require_one_domain(corner(4), bent(corner(7), 0.01))
    require_one_domain(ring(5), turned(ring(6), 0.02))
    require_one_domain(strip(6), strip(6, 0.3, 0.02))


@pytest.mark.parametrize("other", [disc(4), corner(4).moved(1.001 * corner(4).points), turned(corner(4), 0.01)])
def test_meshes_of_two_domains_are_refused_with_a_node(other: Mesh) -> None:
    with pytest.raises(em.InputError, match=r"the node at \(.*\) of a side of one mesh does not lie"):
        require_one_domain(corner(4), other)


def test_a_corner_is_no_curve() -> None:
    mesh = corner(2)
    cut = mesh.points.copy()
    cut[np.argmax(mesh.points.sum(axis=1) * (mesh.y < 1.5) * (mesh.x > 1.5))] -= 0.05  # the corner (2, 1)
    with pytest.raises(em.InputError, match=r"\(1.95, 0.95\)"):
        require_one_domain(mesh, mesh.moved(cut))


def test_a_grid_and_blocks_may_have_one_domain() -> None:
    grid, other = smooth_mesh(5), smooth_mesh(9)
    blocks = Mesh(points=other.points, cells=other.cells, sides=other.sides)
    require_one_domain(grid, blocks)
    require_one_domain(blocks, grid)
    with pytest.raises(em.InputError, match="of one domain"):
        require_one_domain(grid, blocks.moved(1.01 * blocks.points))


def test_a_folded_mesh_is_refused() -> None:
    points = corner(3).points.copy()
    points[[0, 5]] = points[[5, 0]]
    with pytest.raises(em.InputError, match="folded"):
        require_valid(corner(3).moved(points))


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
