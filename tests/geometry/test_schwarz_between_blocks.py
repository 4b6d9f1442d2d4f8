"""Schwarz between blocks that form a grid: the limit is the mesh of the whole."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.blocks.block_grid import BlockGrid
from equimesh.blocks.blocks import Blocks
from solver.blocks.test_block_grid import rows_and_columns

FRONT = em.Expression("tanh(8*(y - 0.5 - 0.1*sin(3*x)))")
DENSITY = em.Expression("1 + 6*exp(-20*((x - 1)**2 + (y - 0.6)**2))")


@pytest.fixture(scope="module")
def grid() -> BlockGrid:
    return BlockGrid.of(Blocks.of(rows_and_columns()))


@pytest.mark.parametrize("overlap", [2, 4])
@pytest.mark.parametrize("monitor", [em.ArcLength(u=FRONT), em.Weight(rho=DENSITY)], ids=["arc length", "weight"])
def test_the_limit_is_the_mesh_of_the_whole(grid: BlockGrid, monitor: em.Monitor, overlap: int) -> None:
    problem = em.Problem(monitor=monitor, domain=grid.domain, grid=grid.grid)
    whole = em.solve(problem, mode=em.Mode.TIGHT)
    found = em.solve(problem, em.Schwarz(subdomains=grid.cuts, overlap=overlap))
    assert found.decomposition.subdomains == (3, 2)
    assert len(found.iterations) < 12
    assert found.reference.distance(whole.reference) < 1e-9
    assert whole.reference.distance(em.Mesh.uniform(grid.grid)) > 0.02
    mesh = grid.quad_mesh(found.mesh)
    assert not mesh.is_folded
    assert mesh.cell_areas().sum() == pytest.approx(grid.blocks.mesh.cell_areas().sum(), rel=1e-2)
