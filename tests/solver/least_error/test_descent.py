"""Descent: every step is lower and valid, its directions against dense matrices, and folds that are mended."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.least_error import descent, kernels
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.least_error.descent import Descent, descend, search
from equimesh.least_error.kernels import Nodes, Rule
from equimesh.least_error.lifting import SMALLEST_SHARE, mended
from equimesh.least_error.objective import Weights
from equimesh.least_error.quasi_newton import History, quasi_newton_direction, solve_blocks
from equimesh.numerics.types import Array
from equimesh.testing.geometries import disc, naca0012_c
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
    assert search(objective, mesh, now, -now.gradient, 1e-4) is None
    assert search(objective, mesh, now, 0.0 * now.gradient, 1e-4) is None
    assert search(objective, mesh, now, np.full_like(mesh, np.nan), 1e-4) is None
    found = search(objective, mesh, now, now.gradient, 1e-4)
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


def test_blocks_are_solved() -> None:
    rng = np.random.default_rng(3)
    factor, right, out = rng.normal(size=(5, 2, 2)), rng.normal(size=(2, 5)), np.empty((2, 5))
    matrices = factor @ factor.transpose(0, 2, 1) + np.eye(2)
    blocks = np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]])
    solve_blocks(blocks, right.reshape(-1), out.reshape(-1))
    assert out == pytest.approx(np.linalg.solve(matrices, right.T[:, :, None])[..., 0].T, rel=1e-12)


@pytest.mark.parametrize("added", [0, 1, 3, 4, 7])
def test_the_direction_is_that_of_dense_bfgs(added: int) -> None:
    # B^-1 := (I - m c^T / p) B^-1 (I - c m^T / p) + m m^T / p for each kept pair, oldest first.
    kept, count, rng = 5, 5, np.random.default_rng(added)
    hessian = (lambda f: f @ f.T + np.eye(10))(rng.normal(size=(10, 10)))
    moves, changes, pairs = np.zeros((kept, 10)), np.zeros((kept, 10)), []
    for number in range(added):
        move = rng.normal(size=10)
        pairs.append((move, hessian @ move))
        moves[number % kept], changes[number % kept] = pairs[-1]
    blocks = np.stack([rng.uniform(2, 3, count), rng.uniform(-1, 1, count), rng.uniform(2, 3, count)])
    dense = np.zeros((10, 10))
    for node in range(count):
        a, b, d = blocks[:, node]
        dense[np.ix_([node, count + node], [node, count + node])] = np.linalg.inv([[a, b], [b, d]])
    if pairs:
        move, change = pairs[-1]
        dense *= (move @ change) / (change @ dense @ change)
    for move, change in pairs[1 - kept :]:
        p = move @ change
        left = np.eye(10) - np.outer(move, change) / p
        dense = left @ dense @ left.T + np.outer(move, move) / p
    gradient, out = rng.normal(size=2 * count), np.empty(2 * count)
    products = (moves * changes).sum(axis=1)
    quasi_newton_direction(moves, changes, products, added, blocks, gradient, out)
    assert out == pytest.approx(dense @ gradient, rel=1e-9)


def test_the_history_keeps_the_last_pairs_of_positive_curvature() -> None:
    rng, blocks = np.random.default_rng(1), np.array([[2.0], [0.0], [2.0]])
    history, gradient = History(2, 8), np.array([[1.0], [3.0]])
    assert history.is_empty
    assert np.array_equal(history.direction(gradient, blocks), gradient / 2)
    nothing = np.zeros((2, 1))
    history.add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[-1.0], [0.0]]))
    history.add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[0.0], [1.0]]))
    assert history.is_empty
    for _ in range(24):
        move = rng.normal(size=(2, 1))
        before, slope = rng.normal(size=(2, 2, 1))
        change = np.array([[4.0], [9.0]]) * move
        history.add(before, before + move, slope, slope + change)
        history.add(before, before - move, slope, slope + change)  # of negative curvature: not kept
        # The last pair is met exactly: its change of the gradient leads to its move.
        assert history.direction(np.array([[4.0], [9.0]]) * move, blocks) == pytest.approx(move, rel=1e-9)
    history.clear()
    assert history.is_empty
    assert np.array_equal(history.direction(gradient, blocks), gradient / 2)


def test_a_record_is_plain_numbers_without_its_mesh() -> None:
    grid = em.Grid(n_xi=5, n_eta=4)
    record = Descent(
        level=1,
        levels=3,
        grid=grid,
        step=2,
        steps=8,
        error=0.25,
        gain=math.inf,
        distortion=0.5,
        min_jacobian=math.nan,
        mesh=em.Mesh.uniform(grid),
        start="uniform",
    )
    assert json.loads(json.dumps(record.numbers())) == {
        "level": 1,
        "grid": [5, 4],
        "start": "uniform",
        "step": 2,
        "error": 0.25,
        "gain": None,
        "distortion": 0.5,
        "min_jacobian": None,
    }


SQUARE = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [12, 12]}],
    "joins": [{"from": ["a", "d"], "to": ["b", "c"]}],
}


def finest(domain: Blocks) -> BlockMesh:
    return BlockMesh.of(domain, block_levels(domain.mesh)[-1])


def smallest(mesh: BlockMesh, unknowns: Array) -> float:
    corners = mesh.cells.corners.reshape(-1)
    here, first = (Nodes(*mesh.chart.nodes(one), corners) for one in (unknowns, mesh.first.unknowns))
    return float(kernels.smallest_share(here, first))


def folded(mesh: BlockMesh, node: int) -> Array:
    """The first mesh with one node, and its copy, moved by three cells."""
    moves = np.zeros_like(mesh.first.unknowns)
    moves[:, node] = 3.0 * mesh.chart.length / np.sqrt(mesh.cells.count)
    moves *= mesh.chart.free
    mesh.cells.tie(moves)
    return mesh.first.unknowns + moves


@pytest.mark.parametrize("place", ["inside", "on the circle"])
def test_a_fold_is_mended_and_the_rest_stays(place: str) -> None:
    domain = disc(800)
    mesh, (x, y) = finest(domain), domain.mesh.points.T
    # Away from the four points where the blocks meet the circle.
    node = int(np.hypot(x - (0.2 if place == "inside" else 1.0), y - 0.1).argmin())
    assert (domain.node_curve[node] >= 0) == (place != "inside")
    before = folded(mesh, node)
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    changed = (after != before).any(axis=0)
    assert 0 < changed.sum() < 40
    assert np.hypot(x - x[node], y - y[node])[changed].max() < 0.3
    on_circle = domain.node_curve >= 0
    assert np.hypot(*np.stack(mesh.chart.nodes(after))[:, on_circle]) == pytest.approx(1.0, abs=1e-13)


def test_tied_nodes_stay_together() -> None:
    domain = Blocks.of(SQUARE)
    mesh = finest(domain)
    copies, originals = mesh.cells.ties.T
    before = folded(mesh, int(originals[len(originals) // 2]))
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    apart = after[:, copies] - after[:, originals]
    assert apart == pytest.approx(mesh.first.unknowns[:, copies] - mesh.first.unknowns[:, originals], abs=1e-14)


def test_a_mesh_without_folds_is_the_same() -> None:
    mesh = finest(disc(400))
    first = mesh.first.unknowns
    assert mended(mesh.chart, mesh.cells, first, first) is first


def test_in_thin_cells_nodes_move_less_than_the_one_that_folds_them() -> None:
    """The mean of the displacements around it would take it back by most of its way."""
    domain = Blocks.of(
        {**SQUARE, "joins": [], "blocks": [{**SQUARE["blocks"][0], "cells": [12, 24], "grading": [1, 2e3]}]}
    )
    mesh, (x, y) = finest(domain), domain.mesh.points.T
    up = 0.05 * np.sin(np.pi * x) * (1.0 - np.exp(-y / 0.03)) * np.exp(-y / 0.3)
    up[np.hypot(x - 0.5, y - 0.02).argmin()] -= 0.02
    before = mesh.first.unknowns + np.stack([np.zeros_like(up), up]) * mesh.chart.free
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    assert np.abs(after - before).max() < 0.01


def test_what_has_slid_around_the_nose_of_an_airfoil_is_mended_by_shorter_displacements() -> None:
    """Corners that are unfolded one after the other fold each other there."""
    domain = naca0012_c(2000)
    mesh = finest(domain)
    x, y = domain.mesh.points.T
    moves = np.zeros_like(mesh.first.unknowns)
    near = np.hypot(x, y) < 0.05
    moves[:, near] = np.array([[0.05], [0.03]])
    before = mesh.first.unknowns + moves * mesh.chart.free
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
