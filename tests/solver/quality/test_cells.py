"""Cells as bilinear quadrilaterals: blocks of them, numbers of Gauss points, and Jacobians."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.quality import cells as bilinear
from equimesh.quality import measures
from equimesh.quality.measures import equidistribution, measure
from solver.quality.handmade import CONSTANT, PAPER, Analytic, uniform, wavy


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
    assert sum(seen) == 400 * 400 * 2**2
    assert max(seen) <= bilinear.BLOCK_POINTS
    assert len(seen) > 5


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
