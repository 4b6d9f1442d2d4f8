"""Densities on the reference square: the area of the domain's map is in them, and coarse tables miss no detail."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.gradient_map import MAX_TABLE_CELLS, MIN_DENSITY_SHARE, MIN_TABLE_CELLS, Density

GRID = em.Grid(n_xi=17, n_eta=33)


def of(rho: str, domain: em.Domain, grid: em.Grid = GRID) -> Density:
    return Density.of(em.Weight(rho=em.Expression(rho)).on(domain), domain, grid)


def test_the_density_is_that_of_the_physical_domain() -> None:
    density = of("1 + x**2 + y**2", em.AnnulusSector())
    radius = 1.0 + np.linspace(0, 1, MIN_TABLE_CELLS + 1)
    expected = (1.0 + radius**2) * radius  # the Jacobian of polar coordinates
    assert np.allclose(density.table, (expected / expected.max())[:, None], rtol=1e-12)
    assert density.extents == pytest.approx((1.0, 1.5 * np.pi / 2), rel=1e-6)


def test_tables_grow_with_the_grid_within_limits() -> None:
    assert of("1", em.Rectangle(), em.Grid(n_xi=300, n_eta=9)).table.shape == (513, MIN_TABLE_CELLS + 1)
    assert of("1", em.Rectangle(), em.Grid(n_xi=9, n_eta=1500)).table.shape[1] == MAX_TABLE_CELLS + 1


def test_a_thin_density_is_seen_by_a_coarse_grid() -> None:
    thin = of("1 + 1000*exp(-(200*(x - 0.53))**2)", em.Rectangle())
    coarse = thin.on(em.Grid(n_xi=9, n_eta=9))
    mean = coarse[1:-1].sum(axis=0)[4] + 0.5 * (coarse[0, 4] + coarse[-1, 4])
    assert mean / (coarse.shape[0] - 1) == pytest.approx(float(thin.table[:-1, 4].mean()), rel=0.01)
    assert coarse.max() < 0.2  # spread over the cells of the grid
    assert coarse.shape == (9, 9)


def test_a_constant_density_stays_one() -> None:
    assert np.allclose(of("3", em.Rectangle(x=(0, 5))).on(em.Grid(n_xi=5, n_eta=40)), 1.0, rtol=1e-13)


def test_tiny_densities_count_as_a_share() -> None:
    density = of("exp(-100*x)", em.Rectangle())
    assert density.is_finite
    assert density.table.min() == MIN_DENSITY_SHARE


def test_a_density_that_is_not_finite_is_noticed() -> None:
    class Broken(em.Expression):
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            return tuple(np.where(x > 0.5, np.nan, part) for part in super().evaluate(x, y, order))

    square = em.Rectangle()
    assert not Density.of(em.Weight(rho=Broken("1")), square, GRID).is_finite
