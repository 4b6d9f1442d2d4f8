"""Cells as bilinear quadrilaterals: blocks of them, numbers of Gauss points, and Jacobians."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from block_cases import in_blocks, l_shape
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.rows import STRIP_NODES
from equimesh.monitors.metrics import ArcLength
from equimesh.quality import cells as bilinear
from equimesh.quality import measures
from equimesh.quality.cells import BilinearCells, corner_angles, measure_angles
from equimesh.quality.measures import equidistribution, measure
from equimesh.quality.resolution import Pieces
from solver.quality.handmade import CONSTANT, PAPER, Analytic, folded, one_quad, uniform, wavy


def test_blocks_do_not_change_the_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = measure(wavy(), ArcLength(u=PAPER, scaled=False)).summary(arrays=True)
    monkeypatch.setattr(bilinear, "BLOCK_POINTS", 64 * 7)  # seven cells at a time, 96 in all
    blocked = measure(wavy(), ArcLength(u=PAPER, scaled=False)).summary(arrays=True)
    for name in measures.PER_CELL:
        assert np.array(blocked[name]["cells"]) == pytest.approx(np.array(whole[name]["cells"]), rel=1e-12)
    assert blocked["interpolation_error"] == pytest.approx(whole["interpolation_error"], rel=1e-12)


def test_memory_is_bounded_and_large_meshes_use_fewer_gauss_points() -> None:
    seen: list[int] = []

    def value(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        seen.append(x.size)
        return PAPER.value(x, y)

    counting = ArcLength(u=Analytic(value, PAPER.along_x, PAPER.along_y), scaled=False)
    equidistribution(uniform(17, 33), counting)  # 512 cells
    assert sum(seen) == 16 * 32 * 8**2
    seen.clear()
    equidistribution(uniform(17, 34), counting)
    assert sum(seen) == 16 * 33 * 3**2
    seen.clear()
    equidistribution(uniform(401), counting)
    assert len(seen) > 4
    assert sum(seen) == 401 * (401 + len(seen) - 1), "the nodes, and those between two strips once more"
    assert max(seen) < STRIP_NODES + 3 * 401


@pytest.mark.parametrize("name", ["parallelogram", "rectangle"])
def test_a_mesh_of_equal_parallelograms_has_jacobian_one(name: str) -> None:
    x, y = uniform(9, 14).x, uniform(9, 14).y
    mesh = Mesh(3 * x + y, 0.5 * y + x / 7) if name == "parallelogram" else Mesh(200 * x - 3, 1e-3 * y)
    q = measure(mesh, ArcLength(u=CONSTANT, scaled=False))
    assert q.min_jacobian == pytest.approx(1.0)
    assert q.min_jacobian_over_mean == pytest.approx(1.0)
    assert q.q_eq.cells == pytest.approx(np.ones((8, 13)))


@pytest.mark.parametrize("domain", [em.Rectangle(x=(-1.0, 3.0)), em.AnnulusSector()], ids=["rectangle", "sector"])
def test_uniform_cells_are_those_of_the_uniform_mesh(domain: em.Domain) -> None:
    grid = em.Grid(n_xi=7, n_eta=12)
    cells, mesh = bilinear.UniformCells(grid, domain), bilinear.BilinearCells(map_mesh(Mesh.uniform(grid), domain))
    assert cells.shape == mesh.shape
    for some in (slice(3, 40), np.array([0, 65, 17])):
        assert np.array_equal(cells.corners(some), mesh.corners(some))
    assert cells.all_valid
    assert cells.total_area == pytest.approx(mesh.total_area, rel=0.02)


# Angles at the corners of cells.


def test_angles_by_hand() -> None:
    trapezium = one_quad((0.0, 0.0), (3.0, 0.0), (2.0, 1.0), (1.0, 1.0))
    assert corner_angles(trapezium)[:, 0] == pytest.approx([45.0, 45.0, 135.0, 135.0])
    found = measure_angles(trapezium, from_degrees=50.0)
    assert (found.smallest, found.largest, found.share_within) == pytest.approx((45.0, 135.0, 0.5))
    assert measure_angles(l_shape(bend=0.0)).summary() == pytest.approx({"min": 90, "max": 90, "share_within": 1})


def test_the_sum_of_a_cell_is_a_full_turn_and_blocks_agree_with_their_grid() -> None:
    grid = wavy()
    whole = in_blocks(grid)
    assert corner_angles(grid).sum(axis=0) == pytest.approx(np.full(12 * 8, 360.0))
    assert measure_angles(whole.mesh).summary() == pytest.approx(measure_angles(grid).summary())
    sheared = Mesh(uniform(5).x + 3 * uniform(5).y, uniform(5).y)
    assert measure_angles(sheared).share_within == 0.0


def test_a_folded_cell_has_an_angle_beyond_a_half_turn() -> None:
    assert measure_angles(folded()).largest > 180.0
    assert measure_angles(wavy()).largest < 180.0


# Integrals of interpolation errors over pieces of cells.


def of(mesh: em.Mesh, u: em.Expression) -> Pieces:
    cells = BilinearCells(mesh)
    numbers = np.arange(cells.count)
    return Pieces.of(cells, numbers, cells.corner_values(u.evaluate(*cells.nodes)[0], numbers))


def test_the_quarters_of_a_cell_have_its_area_and_its_interpolant() -> None:
    u = em.Expression("sin(3*x)*y")
    whole = of(wavy(5, 4), u)
    quarters = whole.quarters()
    assert quarters.count == 4 * whole.count

    def areas(pieces: Pieces) -> np.ndarray:
        x, y = pieces.corners[:4], pieces.corners[4:]
        return 0.5 * ((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0]))

    assert areas(quarters).reshape(4, -1).sum(axis=0) == pytest.approx(areas(whole))
    assert (areas(quarters) > 0.0).all()
    # the corner that the four quarters share is the centre, where the interpolant is the mean of the corners
    for values in (quarters.values[2, : whole.count], quarters.values[0, 2 * whole.count : 3 * whole.count]):
        assert values == pytest.approx(whole.values.mean(axis=0))
    together = quarters.errors(u)[:2].reshape(2, 4, -1).sum(axis=1)
    assert together == pytest.approx(whole.errors(u)[:2], rel=1e-4)


def test_a_jump_is_missed_by_the_gradient_and_seen_on_the_rim() -> None:
    mesh = wavy(9, 9)
    for u, missed in (("where(x + y < 0.9, 0, 1)", 0.5), ("exp(-x/1e-7)", 0.5), ("tanh(4*(x - y))", 0.0)):
        _, square, lost = of(mesh, em.Expression(u)).errors(em.Expression(u)).sum(axis=1)
        assert (lost > missed * square) if missed else (lost < 0.02 * square), u


def test_blocks_do_not_change_the_errors() -> None:
    u = em.Expression("tanh(9*(x - y))")
    pieces = of(wavy(60, 50), u)
    assert pieces.count > 2 * 1024
    some = np.arange(5, pieces.count, 7)
    assert pieces.some(some).errors(u) == pytest.approx(pieces.errors(u)[:, some], rel=1e-13)
