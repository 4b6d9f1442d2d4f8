"""Charts: the derivatives by their unknowns, also where nodes are tied, and where a closed line is cut."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curves import Line
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import KNOWN_MESHES, DomainChart
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective
from equimesh.numerics.types import Array
from equimesh.testing.geometries import cylinder, disc, naca0012_o
from solver.bent import WEIGHTS, remainders, uniform

GRID = em.Grid(n_xi=6, n_eta=17)
RING = em.AnnulusSector(angles=(0.0, 360.0))
WAVE = em.Expression("tanh(3*(x*y - 0.3)) + x")
CLOSED = {
    "ring": (RING, (False, True), WAVE),
    "torus": (em.Rectangle(), (True, True), em.Expression("sin(2*pi*x)*cos(2*pi*y) + sin(4*pi*(x + y))")),
}


def tied_moves(closed: tuple[bool, bool], seed: int, share: float) -> Array:
    cells = cells_of_grid(GRID.shape, closed)
    moves = np.random.default_rng(seed).uniform(-share, share, (2, GRID.points)) * cells.free
    cells.tie(moves)
    return moves / (np.array(GRID.shape)[:, None] - 1)


def objective_on(name: str) -> Objective:
    domain, closed, u = CLOSED[name]
    cells = cells_of_grid(GRID.shape, closed)
    return Objective(u, DomainChart(domain), cells, uniform(GRID), WEIGHTS, Rule())


@pytest.mark.parametrize("name", CLOSED)
def test_the_taylor_remainder_falls_at_second_order_where_nodes_are_tied(name: str) -> None:
    objective, closed = objective_on(name), CLOSED[name][1]
    mesh, direction = uniform(GRID) + tied_moves(closed, 1, 0.2), tied_moves(closed, 2, 1.0)
    here = objective.evaluate(mesh)

    def value(h: float) -> float:
        then = objective.evaluate(mesh + h * direction)
        return then.value

    first, second = remainders(value, float(np.vdot(here.gradient, direction)), 1e-3)
    assert first > 1e-9
    assert first / second == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("name", CLOSED)
def test_the_objective_does_not_depend_on_where_a_closed_line_is_cut(name: str) -> None:
    objective, closed = objective_on(name), CLOSED[name][1]
    moves = tied_moves(closed, 3, 0.2).reshape(2, *GRID.shape)
    here = objective.evaluate(uniform(GRID) + moves.reshape(2, -1))
    rolled = moves[:, :, :-1]
    rolled = np.roll(rolled, 2, axis=2)
    rolled = np.concatenate([rolled, rolled[:, :, :1]], axis=2)
    turned = objective_turned(name, 2)
    there = turned.evaluate(uniform(GRID) + rolled.reshape(2, -1))
    assert there.value == pytest.approx(here.value, rel=1e-12)
    gradient = here.gradient.reshape(2, *GRID.shape)[:, :, :-1]
    other = there.gradient.reshape(2, *GRID.shape)[:, :, :-1]
    assert other == pytest.approx(np.roll(gradient, 2, axis=2), rel=1e-9, abs=1e-11)


def objective_turned(name: str, by: int) -> Objective:
    """The same objective on the same nodes, of a domain whose closed lines begin ``by`` cells earlier."""
    domain, closed, u = CLOSED[name]
    if name == "ring":
        first = -360.0 * by / (GRID.n_eta - 1)
        domain = em.AnnulusSector(angles=(first, first + 360.0))
    else:
        shift = by / (GRID.n_eta - 1)
        domain = em.Rectangle(y=(-shift, 1.0 - shift))
    cells = cells_of_grid(GRID.shape, closed)
    return Objective(u, DomainChart(domain), cells, uniform(GRID), WEIGHTS, Rule())


def test_copies_have_no_derivative_of_their_own() -> None:
    objective = objective_on("torus")
    here = objective.evaluate(uniform(GRID) + tied_moves((True, True), 4, 0.2))
    copies, originals = objective.cells.ties.T
    assert len(copies) == GRID.n_xi + GRID.n_eta - 1
    assert (here.gradient[:, copies] == 0.0).all()
    assert (here.gradient[:, originals] != 0.0).all()
    assert math.isfinite(here.value)


@pytest.mark.parametrize("make", [disc, cylinder, naca0012_o])
def test_the_taylor_remainder_falls_at_second_order_on_curves(make) -> None:  # type: ignore[no-untyped-def]
    domain = make(400)
    mesh = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    first, rng = mesh.first.unknowns, np.random.default_rng(5)
    share = 0.02 * mesh.chart.length / math.sqrt(mesh.cells.count)
    here_moves, direction = (rng.uniform(-share, share, first.shape) * mesh.chart.free for _ in range(2))
    objective = Objective(WAVE, mesh.chart, mesh.cells, first, WEIGHTS, Rule())
    here = objective.evaluate(first + 0.05 * here_moves)

    def value(h: float) -> float:
        then = objective.evaluate(first + 0.05 * here_moves + h * direction)
        return then.value

    first_rest, second_rest = remainders(value, float(np.vdot(here.gradient, direction)), 2e-3)
    assert first_rest > 1e-12
    assert first_rest / second_rest == pytest.approx(4.0, abs=0.6)
    assert (here.gradient[mesh.chart.free == 0.0] == 0.0).all()


def test_a_chart_of_some_nodes_is_the_same_there() -> None:
    domain = disc(400)
    mesh = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    nodes = np.sort(np.random.default_rng(6).permutation(domain.points)[:150])
    part, first = mesh.chart.on(nodes), mesh.first.unknowns
    x, y = mesh.chart.nodes(first)
    assert np.array_equal(np.stack(part.nodes(first[:, nodes])), np.stack([x[nodes], y[nodes]]))
    assert part.length == mesh.chart.length


@pytest.mark.parametrize("make", [disc, cylinder])
def test_moves_of_nodes_become_moves_along_curves(make) -> None:  # type: ignore[no-untyped-def]
    domain = make(400)
    chart = BlockMesh.of(domain, block_levels(domain.mesh)[-1]).chart
    first, h = chart.unknowns(domain.mesh.points.T.copy(), domain.node_parameter), 1e-6
    moves = np.random.default_rng(7).uniform(-h, h, first.shape)
    there = np.stack(chart.nodes(first + chart.pulled(first, moves))) - np.stack(chart.nodes(first))
    free, slides = chart.free[1] > 0.0, (chart.free == np.array([[1.0], [0.0]])).all(axis=0)
    assert there[:, free] == pytest.approx(moves[:, free], abs=1e-14)
    # What is left of a move is across the curve.
    left = ((moves - there) * there)[:, slides].sum(axis=0)
    assert np.abs(left).max() < 1e-4 * h * h
    assert (np.hypot(*there)[slides] > 0.01 * h).any()
    assert (there[:, ~free & ~slides] == 0.0).all()


def test_nodes_of_lines_are_those_of_each_line() -> None:
    domain = cylinder(400)
    chart = BlockMesh.of(domain, block_levels(domain.mesh)[-1]).chart
    shift = 0.01
    x, y = chart.nodes(chart.unknowns(domain.mesh.points.T.copy(), domain.node_parameter + shift))
    lines = 0
    for number, curve in enumerate(domain.curves):
        nodes = np.flatnonzero(domain.node_curve == number)
        at_x, at_y, _, _ = curve.evaluate(domain.node_parameter[nodes] + shift)
        assert x[nodes] == pytest.approx(at_x, abs=1e-13)
        assert y[nodes] == pytest.approx(at_y, abs=1e-13)
        lines += isinstance(curve, Line)
    assert lines == 4


def test_the_nodes_of_the_last_meshes_are_kept() -> None:
    domain = disc(400)
    chart = BlockMesh.of(domain, block_levels(domain.mesh)[-1]).chart
    first = chart.unknowns(domain.mesh.points.T.copy(), domain.node_parameter)
    found = chart.at(first)
    for k in range(KNOWN_MESHES - 1):
        assert chart.at(first + k) is not found
    assert chart.at(first) is found
    for k in range(KNOWN_MESHES):
        chart.at(first + k)
    assert chart.at(first) is not found
