"""Windows become strips of rows."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh_cluster.parts.holding import OnChannel, cuts_of_rows, rows_of

GRID = em.Grid(n_xi=20, n_eta=13)


@pytest.mark.parametrize(("subdomains", "parts"), [((5, 1), 2), ((5, 1), 5), ((2, 3), 4), ((1, 3), 3)], ids=str)
def test_every_part_has_its_rows_and_one_more_each_way(subdomains: tuple[int, int], parts: int) -> None:
    decomposition = em.Decomposition(grid=GRID, subdomains=subdomains, overlap=2)
    mesh = em.Mesh(*np.random.default_rng(4).normal(size=(2, *GRID.shape)))

    def rows(channel: Channel) -> tuple[list[int], dict[str, int]]:
        holding = OnChannel(channel, decomposition)
        held, cuts = rows_of(holding, holding.cut(mesh)), cuts_of_rows(holding)
        number = channel.number
        assert (held.begin, held.end) == (max(cuts[number] - 1, 0), min(cuts[number + 1] + 1, 20))
        assert np.array_equal(held.x, mesh.x[held.begin : held.end])
        assert np.array_equal(held.y, mesh.y[held.begin : held.end])
        return cuts, holding.sent

    found = ThreadChannels(parts).run(rows)
    assert all(cuts == found[0][0] for cuts, _ in found)
    if subdomains[1] == 1:
        assert sum(sent["rows"] for _, sent in found) == 2 * (parts - 1) * 13 * 16, "strips stay where they are"
