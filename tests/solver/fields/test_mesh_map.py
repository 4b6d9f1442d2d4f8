"""The map of a mesh and its inverse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import closed_of, map_mesh
from equimesh.fields.mesh_map import (
    MIN_START_STEP_CELLS,
    MeshMap,
    Places,
    find_cells,
    hop,
    place_by_splines,
    place_in_cells,
    place_in_patches,
)
from equimesh.fields.on_domain import reference_of, reference_on
from equimesh.meshes.nested import closed_mesh
from equimesh.quality.measures import measure_errors
from solver.fields.bent_meshes import ANYWHERE, largest, smooth_mesh


def test_the_inverse_of_the_map_leads_back(front: em.Mesh) -> None:
    of = MeshMap.of(front)
    places = of.locate(*ANYWHERE)
    assert places.smooth.all()
    back = [part.evaluate(places.s, places.t)[0] for part in (of.x, of.y)]
    assert largest(tuple(back), tuple(ANYWHERE)).max() < 1e-12
    nodes = of.locate(front.x, front.y)
    i, j = np.indices(front.x.shape)
    assert np.abs(nodes.s - i.ravel()).max() < 1e-9
    assert np.abs(nodes.t - j.ravel()).max() < 1e-9


def test_the_way_back_from_a_domain(front: em.Mesh) -> None:
    ring = em.AnnulusSector(center=(0.3, 0.0), radii=(0.5, 2.0), angles=(10, 130))
    for domain in (em.Rectangle(x=(-1.0, 3.0), y=(0.0, 0.5)), ring):
        back = reference_of(map_mesh(front, domain), domain)
        assert max(np.abs(back.x - front.x).max(), np.abs(back.y - front.y).max()) < 1e-13


def test_the_map_of_a_sheared_grid_is_exact() -> None:
    start = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=9))
    places = MeshMap.of(em.Mesh(2 * start.x + start.y, start.y - 0.5 * start.x)).locate(
        2 * ANYWHERE[0] + ANYWHERE[1], ANYWHERE[1] - 0.5 * ANYWHERE[0]
    )
    assert largest((places.s, places.t), (5 * ANYWHERE[0], 8 * ANYWHERE[1])).max() < 1e-12


def test_a_folded_mesh_has_no_inverse() -> None:
    mesh = smooth_mesh(9)
    with pytest.raises(em.InputError, match="the mesh is folded") as caught:
        MeshMap.of(em.Mesh(mesh.x[::-1].copy(), mesh.y))
    assert caught.value.field == "mesh"


@pytest.mark.parametrize("shape", [(9, 9), (1, 700), (35, 20), (700, 1)])
def test_the_place_of_a_point_does_not_depend_on_the_others(front: em.Mesh, shape: tuple[int, int]) -> None:
    of, (x, y) = MeshMap.of(front), np.random.default_rng(3).uniform(0.0, 1.0, (2, *shape))
    rows, alone = of.locate(x, y), [of.locate(*point) for point in zip(x.ravel(), y.ravel(), strict=True)]
    assert np.array_equal(rows.s, [place.s[0] for place in alone])
    assert np.array_equal(rows.t, [place.t[0] for place in alone])


def test_points_that_stay_on_a_piece_are_where_each_is_found_alone(front: em.Mesh) -> None:
    of = MeshMap.of(front)
    # Points inside, points of the sides, and points whose way leads over nodes.
    x, y = (np.concatenate([q.ravel(), nodes.ravel()]) for q, nodes in zip(ANYWHERE, (front.x, front.y), strict=True))
    nodes, splines, n = (of.mesh.x, of.mesh.y), of._splines, x.size
    cells, starts = (np.full(n, -1), np.full(n, -1)), (np.empty(n), np.empty(n))
    find_cells((x, y), nodes, 1, cells)
    place_in_cells((x, y), nodes, cells, MIN_START_STEP_CELLS, starts)
    at_once, alone = (Places(np.empty(n), np.empty(n), np.zeros(n, dtype=bool)) for _ in range(2))
    place_in_patches((x, y), splines, starts, at_once)
    assert place_by_splines((x, y), splines, starts, 0, n, alone) == 0
    stayed = at_once.smooth
    assert stayed[: ANYWHERE[0].size].mean() > 0.9
    assert not stayed.all(), "some leave the piece that they start on, and are left for the other way"
    for one, other in ((at_once.s, alone.s), (at_once.t, alone.t)):
        assert np.abs(one[stayed] - other[stayed]).max() < 1e-13 * max(front.x.shape)


def test_a_point_of_an_edge_has_the_cell_that_begins_nearer() -> None:
    """Of that of the point before it, here 3, and that of the point above, here 2."""
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    cells = np.full(4, -1), np.full(4, -1)
    find_cells((np.array([0.4, 0.3, 0.4, 0.375]), np.full(4, 0.3)), (mesh.x, mesh.y), 2, cells)
    assert cells[0].tolist() == [3, 2, 3, 3]


def test_points_are_found_from_cells_nearby() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    points, wanted = (np.array([0.3, 0.9, 0.5]), np.array([0.4, 0.1, 0.55])), ([2, 7, -1], [3, 0, -1])  # one on an edge
    cells = np.array([2, 6, 4]), np.array([3, 1, 4])
    hop(points, (mesh.x, mesh.y), 3, 0, 3, cells)
    assert (cells[0].tolist(), cells[1][:2].tolist()) == (wanted[0], wanted[1][:2])


def test_points_that_are_not_finite_have_a_place_all_the_same() -> None:
    places = MeshMap.of(smooth_mesh(9)).locate(np.array([np.nan, 0.0]), np.array([0.5, np.inf]))
    assert largest((places.s, places.t), (np.zeros(2), np.zeros(2))).max() < 1e-15


@pytest.mark.parametrize("angle", [170.0, 200.0, 300.0, 360.0])
def test_a_point_is_found_across_a_domain_that_is_not_convex(angle: float) -> None:
    domain = em.AnnulusSector(radii=(0.5, 1.0), angles=(0.0, angle))
    square = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=33))
    mesh = map_mesh(square, domain)
    assert reference_of(mesh, domain).distance(square) < 1e-12
    s, t = np.random.default_rng(1).uniform(0.03, 0.97, (2, 300))  # in no order: each walk crosses the domain
    places = MeshMap.of(mesh).locate(*domain.map(s, t))
    assert np.abs(places.s / 16 - s).max() < 1e-3
    assert np.abs(places.t / 32 - t).max() < 1e-3


@pytest.mark.parametrize("turned", [False, True])
def test_a_point_next_to_the_cut_of_a_ring_is_found_from_the_other_side(turned: bool) -> None:
    domain, n = em.AnnulusSector(closed=True), 33
    mesh = map_mesh(em.Mesh.uniform(em.Grid(n)), domain)
    of = MeshMap.of(em.Mesh(mesh.x.T[::-1].copy(), mesh.y.T[::-1].copy()) if turned else mesh)
    s, t = np.full(2, 0.5), np.array([0.999, 0.001])  # the walk to the second point begins at the first
    places = of.locate(*domain.map(s, t))
    around = 1.0 - places.s / (n - 1) if turned else places.t / (n - 1)
    assert around == pytest.approx(t, abs=1e-4)


@pytest.mark.parametrize(
    ("domain", "formula"),
    [(em.AnnulusSector(closed=True), "exp(x)*y"), (em.Rectangle(x=(1, 3), periodic="both"), "sin(pi*x)*cos(2*pi*y)")],
)
def test_the_reference_of_a_mesh_whose_seam_bends_is_found(domain: Any, formula: str) -> None:
    s, t = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 33), indexing="ij")
    bent = closed_mesh(em.Mesh(s, t + 0.1 * np.sin(3 * s) - 0.04), closed_of(domain))
    mesh, u = map_mesh(bent, domain), em.Expression(formula)
    assert reference_on(mesh, domain).distance(bent) < 1e-12
    estimate = em.adapt_round(mesh, u.evaluate(mesh.x, mesh.y)[0], domain).estimate_h1
    assert estimate == pytest.approx(measure_errors(mesh, u).h1, rel=0.2)
