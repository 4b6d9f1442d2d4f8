"""What is beyond a bound moves to the nodes around."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.transfers.integrals import QuadCells
from equimesh.transfers.repair import give_around, giving_of, nodes_around, repair
from solver.meshes.quad_cases import disc


def test_the_excess_finds_room_around_and_the_sum_stays() -> None:
    cells = QuadCells.of(disc(5))
    weights, values = cells.node_weights, np.full(cells.nodes, 0.5)
    node = int(np.argmin(np.hypot(disc(5).x, disc(5).y)))
    values[node] = 1.5
    before, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    assert give_around(values, weights, (low, high), cells.links)
    assert (values[node], (values != 0.5).sum()) == (1.0, 9)
    assert weights @ values == pytest.approx(before, abs=1e-15)
    assert not give_around(values, weights, (low, high), cells.links)


def test_a_repair_ends_within_the_bounds() -> None:
    cells = QuadCells.of(disc(6))
    weights, rng = cells.node_weights, np.random.default_rng(1)
    values = rng.uniform(-0.4, 1.4, cells.nodes)
    aim, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    repair(values, weights, low, high, giving_of(cells))
    assert 0.0 <= values.min() <= values.max() <= 1.0
    assert weights @ values == pytest.approx(aim, abs=1e-14)


def test_nodes_around_are_counted_once() -> None:
    cells = QuadCells.of(disc(3))
    seen, ring = np.full(cells.nodes[0], -1), np.empty(cells.nodes[0], dtype=np.int64)
    counts = [nodes_around(node, cells.links, seen, ring) for node in range(cells.nodes[0])]
    assert set(counts) == {6, 7, 9}  # at the boundary, where three cells meet, elsewhere
    assert counts.count(7) == 4
