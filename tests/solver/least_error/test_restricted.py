"""Restricted Schwarz for the objective: no worse than steps of the whole, and the same on any threads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import restricted
from equimesh.least_error.cells import Region, cells_of_grid, regions_of
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import descend
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.restricted import Merged, RestrictedDescent
from equimesh.numerics.types import Array
from solver.bent import RING, bent, objective_on, uniform

GRID = em.Grid(n_xi=25, n_eta=21)
WAVE = em.Expression("tanh(10*(y - 0.5 - 0.2*sin(2*pi*x)))")


def regions(columns: int = 3, rows: int = 2, closed: tuple[bool, bool] = (False, False)) -> tuple[Region, ...]:
    i, j = np.arange(GRID.n_xi - 1) * columns // GRID.n_xi, np.arange(GRID.n_eta - 1) * rows // GRID.n_eta
    return regions_of(cells_of_grid(GRID.shape, closed), (i[:, None] * rows + j).ravel(), 4)


def closed_objective() -> Objective:
    """The objective of a mesh whose lines along xi are closed."""
    weights = Weights(distortion=0.06, smoothness=0.1)
    cells = cells_of_grid(GRID.shape, (True, False))
    return Objective(WAVE, DomainChart(em.Rectangle()), cells, uniform(GRID), weights, Rule())


def meshes(found: Iterator[tuple[Array, Merged]]) -> list[tuple[Array, Merged]]:
    return list(found)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_an_exchange_is_worth_as_many_steps_of_the_whole_mesh(norm: Any) -> None:
    objective = objective_on(GRID, rule=Rule(norm=norm))
    whole = [now.value for _, now in descend(objective, uniform(GRID), 8, 0.0)]
    merged = meshes(RestrictedDescent(objective, regions()).descend(uniform(GRID), 3, 8, 0.0))
    values = [now.value for _, now in merged]
    assert values[0] - values[1] > 0.8 * (whole[0] - whole[-1])
    assert values == sorted(values, reverse=True)


def test_the_objective_and_the_error_are_those_of_the_whole_mesh() -> None:
    weights = Weights(distortion=0.03, smoothness=0.1, obliqueness=0.5, largest_cotangent=0.1)
    objective = objective_on(GRID, domain=em.AnnulusSector(), weights=weights, rule=Rule(cells="triangle"))
    mesh = bent(GRID, 3)
    objective.cut(mesh)
    here = objective.evaluate(mesh)
    assert here is not None
    _, now = next(RestrictedDescent(objective, regions()).descend(mesh, 1, 1, 0.0))
    assert now.value == pytest.approx(here.value, abs=1e-13)
    assert now.error == pytest.approx(here.error, rel=1e-13)
    assert now.distortion == pytest.approx(here.distortion, rel=1e-13)
    assert now.smallest_share == objective.smallest_share(mesh)


@pytest.mark.parametrize("is_closed", [False, True])
def test_the_mesh_does_not_depend_on_threads(is_closed: bool) -> None:
    found = []
    for threads in (1, 2):
        objective = closed_objective() if is_closed else objective_on(GRID)
        descent = RestrictedDescent(objective, regions(closed=(is_closed, False)), threads)
        found.append(meshes(descent.descend(uniform(GRID), 2, 4, 0.0))[-1][0])
    assert np.array_equal(*found)


def test_the_copies_of_tied_nodes_stay_a_period_apart() -> None:
    descent = RestrictedDescent(closed_objective(), regions(closed=(True, False)))
    mesh = meshes(descent.descend(uniform(GRID), 3, 8, 0.0))[-1][0].reshape(2, *GRID.shape)
    assert np.abs(mesh[0, -1] - mesh[0, 0] - 1.0).max() < 1e-14
    assert np.array_equal(mesh[1, -1], mesh[1, 0])
    assert np.abs(mesh[0, 0]).max() > 1e-3  # the line on which the grid is cut moves as others do


def test_a_merged_mesh_that_folds_is_drawn_back(monkeypatch: pytest.MonkeyPatch) -> None:
    def far(objective: Objective, mesh: Array, steps: int, min_decrease: float) -> Iterator[tuple[Array, Any]]:
        for moved, now in descend(objective, mesh, steps, min_decrease):
            yield mesh + 6.0 * (moved - mesh), now

    monkeypatch.setattr(restricted, "descend", far)
    objective = objective_on(GRID)
    found = meshes(RestrictedDescent(objective, regions()).descend(uniform(GRID), 2, 8, 0.0))
    assert len(found) > 1
    assert all(now.smallest_share > 0.0 for _, now in found)
    assert found[-1][1].value < found[0][1].value


def test_it_ends_where_exchanges_gain_little_and_where_u_is_met_exactly() -> None:
    descent = RestrictedDescent(objective_on(GRID), regions())
    assert len(meshes(descent.descend(uniform(GRID), 9, 8, 1.0))) == 2
    exact = RestrictedDescent(objective_on(GRID, em.Expression("1 + x - 2*y")), regions())
    assert meshes(exact.descend(uniform(GRID), 9, 8, 0.0)) == []


def test_derivatives_on_a_region_are_those_of_the_whole() -> None:
    weights = Weights(distortion=0.03, smoothness=0.1, obliqueness=0.5, largest_cotangent=0.1)
    for objective, closed in (
        (objective_on(GRID, RING, em.AnnulusSector(), weights=weights), False),
        (closed_objective(), True),
    ):
        mesh = uniform(GRID) + 0.02 * np.prod(np.sin(2.0 * np.pi * uniform(GRID)), axis=0)
        whole = objective.evaluate(mesh)
        assert whole is not None
        for region in regions(closed=(closed, False)):
            local = objective.on(region)
            start = mesh[:, region.nodes]
            sums = local.sums(start, region.own_cells, region.own_triples)
            local.beyond = whole.error**2 - sums.every_square
            there = local.evaluate(start)
            assert there is not None
            moves = region.cells.free.copy()
            region.cells.tie(moves)
            alone = np.setdiff1d(np.flatnonzero(moves[0] * moves[1]), region.cells.ties)
            expected = whole.gradient[:, region.nodes[alone]]
            assert np.abs(there.gradient[:, alone] - expected).max() < 1e-11 * np.abs(whole.gradient).max()
