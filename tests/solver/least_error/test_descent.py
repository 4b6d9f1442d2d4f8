"""Descent: every step is lower and valid, and ends are early where nothing is to be gained."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import descent
from equimesh.least_error.descent import descend, search
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Weights
from solver.bent import DOMAINS, bent, objective_on, uniform

GRID = em.Grid(n_xi=13, n_eta=11)
FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
LITTLE = 5e-3
LOOSE = Weights(distortion=1e-3, smoothness=1e-3)


@pytest.mark.parametrize("domain", DOMAINS)
def test_every_step_is_lower_and_valid_and_keeps_the_sides(domain: str) -> None:
    objective, start = objective_on(GRID, FRONT, DOMAINS[domain]), uniform(GRID)
    steps = list(descend(objective, start, 25, LITTLE))
    values = [now.value for _, now in steps]
    assert len(steps) > 5
    assert np.diff(values).max() < 0.0
    assert steps[-1][1].error < 0.6 * steps[0][1].error
    for mesh, now in steps:
        assert objective.smallest_share(mesh) > 0.0
        assert now.error == pytest.approx(objective.error(mesh), rel=1e-13)
        for k in (0, 1):
            side = (start[k] == 0) | (start[k] == 1)
            assert np.array_equal(mesh[k][side], start[k][side])
    assert steps[0][0] is start


@pytest.mark.parametrize("steps", [0, 1, 4])
def test_there_are_at_most_so_many_steps(steps: int) -> None:
    assert len(list(descend(objective_on(GRID, FRONT), uniform(GRID), steps, LITTLE))) == steps + 1


def test_no_jacobian_falls_below_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descent, "MIN_JACOBIAN_SHARE", 0.3)
    objective = objective_on(GRID, FRONT, weights=LOOSE)
    smallest = [objective.smallest_share(mesh) for mesh, _ in descend(objective, uniform(GRID), 25, LITTLE)]
    assert min(smallest) > 0.3
    assert min(smallest) < 0.5  # it was met


def test_a_start_below_the_floor_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descent, "MIN_JACOBIAN_SHARE", 0.9)
    objective, start = objective_on(GRID, FRONT), bent(GRID, 1)
    assert objective.smallest_share(start) < 0.9
    assert len(list(descend(objective, start, 5, LITTLE))) > 2


def test_it_ends_early_where_little_is_gained() -> None:
    objective = objective_on(GRID, em.Expression("sin(2*pi*x)*sin(2*pi*y)"))
    early = len(list(descend(objective, uniform(GRID), 200, LITTLE)))
    assert early < 0.5 * len(list(descend(objective, uniform(GRID), 200, 1e-9)))


@pytest.mark.parametrize("u", ["0*x", "3", "2*x - 3*y", "1e15 + tanh(20*x)"])
def test_there_is_nothing_where_u_is_met_exactly(u: str) -> None:
    assert list(descend(objective_on(GRID, em.Expression(u)), uniform(GRID), 5, LITTLE)) == []


def test_there_is_nothing_from_a_folded_mesh() -> None:
    folded = uniform(GRID)
    folded[:, GRID.n_eta + 1] = 0.9
    assert list(descend(objective_on(GRID, FRONT), folded, 5, LITTLE)) == []


def test_a_search_uphill_finds_nothing() -> None:
    objective, mesh = objective_on(GRID, FRONT), uniform(GRID)
    now = objective.evaluate(mesh)
    assert now is not None
    assert search(objective, mesh, now, -now.gradient, 1e-4) is None
    assert search(objective, mesh, now, 0.0 * now.gradient, 1e-4) is None
    assert search(objective, mesh, now, np.full_like(mesh, np.nan), 1e-4) is None
    found = search(objective, mesh, now, now.gradient, 1e-4)
    assert found is not None
    assert np.abs(found[0] - mesh).max() <= descent.MAX_MOVE_CELLS / objective.cells.count**0.5
    assert found[1].value < now.value


def test_triangles_are_cut_anew_on_the_way() -> None:
    grid = em.Grid(n_xi=17, n_eta=17)
    objective = objective_on(grid, FRONT, rule=Rule(cells="triangle"), weights=LOOSE)
    objective.cut(uniform(grid))
    for mesh, _ in descend(objective, uniform(grid), 25, LITTLE):
        assert objective.smallest_share(mesh) > 0.0
    last = objective.error(mesh)
    assert objective_on(grid, FRONT, rule=Rule(cells="triangle")).error(mesh) != last
    assert last < 0.7 * objective_on(grid, FRONT, rule=Rule(cells="triangle")).error(uniform(grid))
