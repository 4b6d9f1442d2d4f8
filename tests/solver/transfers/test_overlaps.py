"""Common parts of two meshes: nothing is left out, nothing counts twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import links_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import QuadSearch
from equimesh.meshes.unrolled import Unrolled
from equimesh.transfers.one_domain import boundary_of, first_beyond, in_loops, require_one_domain, require_valid
from equimesh.transfers.overlaps import (
    MAX_CORNERS,
    Overlaps,
    centroids_of,
    clip_cell,
    clip_half_plane,
    corners_from,
    longer,
    moments,
    starts_in,
)
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, ring, strip, turned
from solver.transfers.cases import adapted, fronts

HALF_RING = em.AnnulusSector(angles=(0, 180))


def bent_grids() -> tuple[em.Mesh, em.Mesh]:
    return smooth_mesh(9), smooth_mesh(12, depth=-0.05)


def few_new_cells() -> tuple[em.Mesh, em.Mesh]:
    return smooth_mesh(33), smooth_mesh(4)


def half_rings() -> tuple[em.Mesh, em.Mesh]:
    return adapted("tanh(20*(x + y/2 - 0.75))", 17, HALF_RING), adapted("tanh(9*x)", 24, HALF_RING)


def corners() -> tuple[Mesh, Mesh]:
    return corner(5), bent(corner(6), 0.03)


def discs() -> tuple[Mesh, Mesh]:
    return bent(disc(4), 0.03), disc(4)


def strips() -> tuple[Mesh, Mesh]:
    return strip(7), strip(5, 0.2, 0.03)


def rings() -> tuple[Mesh, Mesh]:
    return ring(4), turned(ring(4), 0.15)


@pytest.mark.parametrize("pair", [bent_grids, fronts, few_new_cells, corners, discs, strips])
def test_the_parts_fill_every_old_and_every_new_cell(pair: Callable[[], Any]) -> None:
    overlaps = Overlaps.of(*pair())
    found = np.bincount(overlaps.cell, overlaps.area, minlength=overlaps.old.area.size)
    assert np.abs(overlaps.covered / overlaps.new.area - 1.0).max() < 1e-12
    assert np.abs(found / overlaps.old.area - 1.0).max() < 1e-12
    assert not overlaps.beyond.any()
    for of_axis in (overlaps.of_x, overlaps.of_y):  # the first moments of an old cell are those of its centroid
        assert np.abs(np.bincount(overlaps.cell, of_axis)).max() < 1e-15


def test_a_mesh_meets_itself_in_its_cells_alone() -> None:
    mesh = smooth_mesh(9)
    overlaps = Overlaps.of(mesh, mesh)
    large = overlaps.area > 1e-15
    assert np.array_equal(overlaps.cell[large], np.arange(overlaps.new.area.size))
    values = np.arange(overlaps.new.area.size, dtype=float)
    assert overlaps.bounds(values, values)[0].size == values.size
    nothing = np.zeros(values.size)
    assert np.abs(overlaps.integrals(values, (nothing, nothing)) / overlaps.new.area - values).max() < 1e-12


@pytest.mark.parametrize("pair", [half_rings, rings])
def test_cells_beyond_a_curved_side_are_seen(pair: Callable[[], Any]) -> None:
    old, new = pair()
    overlaps, nothing = Overlaps.of(old, new), np.zeros(len(old.cells))
    assert overlaps.beyond.max() > 0.01
    assert np.abs(overlaps.integrals(nothing + 3.0, (nothing, nothing)) / overlaps.new.area - 3.0).max() < 1e-12


@pytest.mark.parametrize(("old", "new", "area"), [(smooth_mesh(65), smooth_mesh(4), 1.0), (corner(24), corner(1), 3.0)])
def test_more_parts_than_expected_find_room(old: Any, new: Any, area: float) -> None:
    overlaps = Overlaps.of(old, new)
    assert overlaps.cell.size == overlaps.area.size > 12 * len(new.cells)
    assert overlaps.area.sum() == pytest.approx(area, abs=1e-12)
    assert np.array_equal(longer(np.array([1, 2]), 5)[:2], [1, 2])


def test_starts_are_the_cells_of_the_centres() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=5))
    search = QuadSearch.of(mesh.points, mesh.cells)
    found = starts_in(search.nodes, (search.links, search.boxes, search.edges), search.nodes, mesh.cells)
    assert found.tolist() == list(range(20))


def test_a_cell_out_of_reach_has_the_nearest_old_one() -> None:
    old = corner(3)
    away = old.moved(old.points + np.array([9.0, 0.0]))
    overlaps = Overlaps.of(old, away)
    assert (overlaps.covered == 0.0).all()
    values = np.arange(len(old.cells), dtype=float)
    means = overlaps.integrals(values, (0 * values, 0 * values)) / overlaps.new.area
    assert set(old.points[old.cells[means.round().astype(int)]].max(axis=(1, 2))) == {2.0}


def test_centroids_and_corners_of_copies() -> None:
    mesh, quad = strip(4), np.empty((4, 2))
    x, y = centroids_of(Unrolled.of(mesh))
    assert (x[:16].min(), x.min(), x.max()) == (0.125, -0.875, 1.875)
    assert y.max() == 0.875
    least, most = corners_from((mesh.x.copy(), mesh.y.copy()), mesh.cells[5], 0.25, 0.0, quad)
    assert (least, most, quad[2].tolist()) == ((0.0, 0.25), (0.25, 0.5), [0.25, 0.5])


# The common part of two convex cells.


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
DIAMOND = np.array([[0.5, -0.25], [1.25, 0.5], [0.5, 1.25], [-0.25, 0.5]])


def common(one: np.ndarray, other: np.ndarray) -> tuple[int, np.ndarray]:
    polygon, spare = np.zeros((2, MAX_CORNERS + 8, 2))
    count = clip_cell(one, other, polygon, spare)
    return count, polygon[:count]


def test_a_square_and_a_diamond_share_an_octagon() -> None:
    count, polygon = common(SQUARE, DIAMOND)
    area, of_x, of_y = moments(polygon, count, 0.0, 0.0)
    assert count == 8
    assert (area, of_x, of_y) == pytest.approx((1 - 4 * 0.25**2 / 2, 0.4375, 0.4375), abs=1e-14)
    assert moments(polygon, count, 0.5, 0.5)[1:] == pytest.approx((0.0, 0.0), abs=1e-15)


def test_the_order_does_not_matter_and_a_cell_inside_stays() -> None:
    inside = 0.3 + 0.2 * SQUARE
    for one, other in ((inside, SQUARE), (SQUARE, inside)):
        count, polygon = common(one, other)
        assert moments(polygon, count, 0.0, 0.0)[0] == pytest.approx(0.04, abs=1e-15)


def test_cells_apart_have_nothing_in_common() -> None:
    assert common(SQUARE, SQUARE + np.array([1.5, 0.0]))[0] == 0


def test_a_line_keeps_what_is_on_its_left() -> None:
    kept = np.zeros((8, 2))
    count = clip_half_plane(SQUARE, 4, np.array([0.25, 0.0]), np.array([0.25, 1.0]), kept)
    assert count == 4
    assert kept[:4, 0].max() == 0.25


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
