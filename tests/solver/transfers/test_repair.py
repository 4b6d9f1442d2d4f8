"""Bounds and an integral at once."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.cell_edges import links_of
from equimesh.transfers.integrals import Cells
from equimesh.transfers.repair import give_around, nodes_around, repair, share_out
from solver.meshes.quad_cases import disc

LINKS = links_of(em.Mesh.uniform(em.Grid(n_xi=12, n_eta=9)).cells, 108)


def test_what_is_beyond_a_bound_moves_to_neighbours() -> None:
    rng = np.random.default_rng(5)
    weights, values = rng.uniform(0.5, 2.0, 108), rng.uniform(-0.2, 1.2, 108)
    before = np.sum(weights * values)
    repair(values, weights, np.zeros(108), np.ones(108), LINKS)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.sum(weights * values) == pytest.approx(before, abs=1e-13)


def test_values_within_bounds_stay() -> None:
    values = np.linspace(0.0, 1.0, 108)
    same = values.copy()
    repair(values, np.ones(108), np.zeros(108), np.ones(108), LINKS)
    assert np.array_equal(values, same)


@pytest.mark.parametrize(("aim", "reached"), [(6.0, 6.0), (1.0, 1.0), (50.0, 10.0), (-3.0, 0.0)])
def test_a_sum_is_reached_as_far_as_bounds_allow(aim: float, reached: float) -> None:
    values = np.linspace(0.0, 1.0, 10)
    share_out(values, np.ones(10), np.zeros(10), np.ones(10), aim)
    assert values.sum() == pytest.approx(reached, abs=1e-13)
    assert values.min() >= 0.0
    assert values.max() <= 1.0


# What is beyond a bound moves to the nodes around.


def test_the_excess_finds_room_around_and_the_sum_stays() -> None:
    cells = Cells.of(disc(5))
    weights, values = cells.node_weights, np.full(cells.nodes, 0.5)
    node = int(np.argmin(np.hypot(disc(5).x, disc(5).y)))
    values[node] = 1.5
    before, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    assert give_around(values, weights, (low, high), cells.links)
    assert (values[node], (values != 0.5).sum()) == (1.0, 9)
    assert weights @ values == pytest.approx(before, abs=1e-15)
    assert not give_around(values, weights, (low, high), cells.links)


def test_a_repair_ends_within_the_bounds() -> None:
    cells = Cells.of(disc(6))
    weights, rng = cells.node_weights, np.random.default_rng(1)
    values = rng.uniform(-0.4, 1.4, cells.nodes)
    aim, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    repair(values, weights, low, high, cells.links)
    assert 0.0 <= values.min() <= values.max() <= 1.0
    assert weights @ values == pytest.approx(aim, abs=1e-14)


def test_nodes_around_are_counted_once() -> None:
    cells = Cells.of(disc(3))
    seen, ring = np.full(cells.nodes[0], -1), np.empty(cells.nodes[0], dtype=np.int64)
    counts = [nodes_around(node, cells.links, seen, ring) for node in range(cells.nodes[0])]
    assert set(counts) == {6, 7, 9}  # at the boundary, where three cells meet, elsewhere
    assert counts.count(7) == 4
