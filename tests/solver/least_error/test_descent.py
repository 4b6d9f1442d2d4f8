"""Descent: every step is lower and valid, its directions against dense matrices, and folds that are mended."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.least_error import descent, kernels
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import Descent, descend
from equimesh.least_error.evaluation import Evaluation
from equimesh.least_error.kernels import Nodes, Norm, Rule
from equimesh.least_error.lifting import SMALLEST_SHARE, mended
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.other_errors import ProjectedObjective
from equimesh.least_error.quasi_newton import (
    EVALUATE,
    MAX_TRIALS,
    OVER,
    PAIRS_ADDED,
    SHORTENING,
    TAKEN,
    Way,
    advance,
    quasi_newton_direction,
    solve_blocks,
    take,
    way_from,
)
from equimesh.numerics.types import Array
from equimesh.testing.geometries import disc, naca0012_c
from solver.bent import DOMAINS, WEIGHTS, bent, objective_on, uniform

GRID = em.Grid(n_xi=13, n_eta=11)
FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
LITTLE = 5e-3
LOOSE = Weights(distortion=1e-3, smoothness=1e-3)
KINDS: tuple[tuple[type[Objective], Norm], ...] = ((Objective, "l2"), (Objective, "h1"), (ProjectedObjective, "l2"))
OBLIQUE = {"obliqueness": 0.1, "largest_cotangent": 0.5}


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


def way_on(objective: Objective, steps: int = 5) -> tuple[Way, Evaluation]:
    """A descent that has not begun, and the evaluation of its mesh, which is to be written."""
    mesh = uniform(GRID)
    now = objective.evaluate(mesh)
    assert now is not None
    return way_from(mesh, objective.ties, steps, 0.2, 0.0), now


def test_a_way_that_leads_nowhere_is_over() -> None:
    way, now = way_on(objective_on(GRID, FRONT))
    for wrong in (
        {"blocks": -now.blocks},
        {"gradient": 0.0 * now.gradient},
        {"gradient": np.full_like(now.gradient, np.nan)},
    ):
        way.counts[:] = 0
        descent.write(way, 0, replace(now, **wrong))
        assert advance(way, False) == OVER
        assert advance(way, False) == OVER
    way.counts[:] = 0
    descent.write(way, 0, now)
    assert advance(way, False) == EVALUATE
    assert 0.0 < np.abs(way.trial - uniform(GRID)).max() <= 0.2 * (1.0 + 1e-12)


def refused(way: Way, need: int) -> list[float]:
    """The longest moves of all trials, each of which is refused, until the descent is over."""
    moves = []
    while need == EVALUATE:
        moves.append(float(np.abs(way.trial - way.meshes[way.here]).max()))
        need = advance(way, False)
    assert need == OVER
    return moves


def test_a_trial_is_shortened_until_it_is_taken() -> None:
    way, now = way_on(objective_on(GRID, FRONT))
    descent.write(way, 0, now)
    lengths = np.array(refused(way, advance(way, False)))
    assert len(lengths) == MAX_TRIALS
    assert lengths[1:] == pytest.approx(SHORTENING * lengths[:-1], rel=1e-9)
    way.counts[:] = 0
    need = advance(way, False)
    descent.write(way, 1, now)  # not lower
    need = advance(way, True)
    assert need == EVALUATE
    descent.write(way, 1, replace(now, value=now.value - 1.0, gradient=0.5 * now.gradient))
    assert advance(way, True) == TAKEN
    assert way.here == 1
    # With a pair the steepest way is tried, too.
    lengths = np.array(refused(way, advance(way, False)))
    assert len(lengths) == 2 * MAX_TRIALS
    assert way.counts[PAIRS_ADDED] == 0


def samples_of(u: em.Expression) -> em.GridSamples:
    x = np.linspace(0.0, 1.0, 21)
    return em.GridSamples(x=x, y=x, values=u.evaluate(x[:, None], x[None, :])[0])


@pytest.mark.parametrize(
    ("u", "kind", "norm"),
    [
        *((u, kind, norm) for u in (FRONT, samples_of(FRONT)) for kind, norm in KINDS),
        (em.Expression("sqrt(x) + sqrt(y)*x"), Objective, "l2"),  # its slopes are infinite on two sides
    ],
    ids=str,
)
def test_compiled_steps_are_those_of_python(u: em.Field, kind: type[Objective], norm: Norm) -> None:
    """Those of an objective of which compiled code knows nothing, to the last bit."""
    for grid in (GRID, em.Grid(n_xi=57, n_eta=41)):
        mesh, given = bent(grid, 2), (em.Rectangle(), cells_of_grid(grid.shape), uniform(grid))
        compiled, plain = (
            kind(u, DomainChart(given[0]), *given[1:], replace(WEIGHTS, **OBLIQUE), Rule(norm=norm)) for _ in range(2)
        )
        plain.__dict__["parts"] = None
        assert compiled.parts is not None
        assert (len(compiled.parts.spans) > 1) == (grid is not GRID)
        found, expected = (list(descend(one, mesh, 9, 0.0)) for one in (compiled, plain))
        assert len(found) == len(expected) > 5
        for (one, now), (other, then) in zip(found, expected, strict=True):
            assert np.array_equal(one, other)
            assert now == then
    assert len(descent.take_steps.overloads) == 1  # type: ignore[attr-defined]


def test_whole_numbers_as_weights_are_no_other_type_for_compiled_code() -> None:
    parts = objective_on(GRID, FRONT, weights=replace(WEIGHTS, obliqueness=1, largest_cotangent=2)).parts
    assert parts is not None
    assert {type(scale) for scale in parts.scales} == {float}
    assert parts.scales[2:4] == (1.0, 2.0)


def test_a_step_that_only_python_can_take_keeps_no_memory_for_others() -> None:
    objective = objective_on(GRID, em.Expression("sqrt(x) + sqrt(y)*x"))
    (_, *meshes) = [mesh for mesh, _ in descend(objective, uniform(GRID), 9, 0.0)]
    assert len(meshes) > 5
    assert all(mesh.base is None for mesh in meshes)


@pytest.mark.parametrize(
    "other",
    [
        objective_on(GRID, FRONT, DOMAINS["sector"]),
        objective_on(GRID, FRONT, rule=Rule(cells="triangle")),
        objective_on(GRID, FRONT, rule=Rule(degree=2)),
        objective_on(GRID, em.NodalField(mesh=em.Mesh.uniform(GRID), values=np.ones(GRID.shape))),
        objective_on(em.Grid(n_xi=57, n_eta=41), FRONT, threads=2),
    ],
)
def test_compiled_code_leaves_others_to_python(other: Objective) -> None:
    assert other.parts is None


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


def test_the_last_pairs_of_positive_curvature_are_kept() -> None:
    rng, blocks = np.random.default_rng(1), np.array([[2.0], [0.0], [2.0]])
    way, nothing = way_from(np.zeros((2, 1)), np.empty((0, 2), dtype=np.int64), 60, 1.0, 0.0), np.zeros((2, 1))

    def add(before: Array, after: Array, slope: Array, slope_then: Array) -> None:
        here = way.here
        way.meshes[here], way.meshes[1 - here] = before, after
        way.gradients[here], way.gradients[1 - here] = slope, slope_then
        take(way)

    def direction(gradient: Array) -> Array:
        out, pairs = np.empty((2, 1)), (way.moves, way.changes, way.products)
        quasi_newton_direction(*pairs, way.counts[PAIRS_ADDED], blocks, gradient.reshape(-1), out.reshape(-1))
        return out

    gradient = np.array([[1.0], [3.0]])
    assert np.array_equal(direction(gradient), gradient / 2)
    add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[-1.0], [0.0]]))
    add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[0.0], [1.0]]))
    assert way.counts[PAIRS_ADDED] == 0
    for _ in range(24):
        move = rng.normal(size=(2, 1))
        before, slope = rng.normal(size=(2, 2, 1))
        change = np.array([[4.0], [9.0]]) * move
        add(before, before + move, slope, slope + change)
        add(before, before - move, slope, slope + change)  # of negative curvature: not kept
        # The last pair is met exactly: its change of the gradient leads to its move.
        assert direction(np.array([[4.0], [9.0]]) * move) == pytest.approx(move, rel=1e-9)
    assert way.counts[PAIRS_ADDED] == 24


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
