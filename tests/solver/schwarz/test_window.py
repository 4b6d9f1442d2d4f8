"""Windows: their place in the grid, which of their sides are interfaces, and the way of nodes to and fro."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.schwarz.decomposition import SubdomainWindow

GRID = em.Grid(n_xi=20, n_eta=14)
BLOCKS = em.Decomposition(grid=GRID, subdomains=(3, 2), overlap=3)


@pytest.fixture
def mesh() -> em.Mesh:
    x = np.arange(20.0 * 14).reshape(20, 14)
    return em.Mesh(x, -x)


def test_a_window_in_the_middle_of_the_lower_row() -> None:
    part = BLOCKS.at(1, 0)
    window = SubdomainWindow(BLOCKS, part, 1)
    assert window.open == {(0, 0): True, (0, 1): True, (1, 0): False, (1, 1): True}
    assert window.physical == ((False, False), (True, False))
    assert window.first == (part.columns[0] - 1, 0)
    assert window.shape == (len(part.columns) + 2, len(part.rows) + 1)
    assert window.covered == (slice(part.columns[0], part.columns[-1] + 1), slice(0, part.rows[-1] + 1))


def test_the_frame_counts_the_edges_beyond() -> None:
    part = BLOCKS.at(1, 0)
    found = SubdomainWindow(BLOCKS, part, 1).frame(GRID.shape)
    assert found.physical == ((False, False), (True, False))
    assert found.beyond == ((part.columns[0], 19 - part.columns[-1]), (0.0, 13 - part.rows[-1]))


@pytest.mark.parametrize("ghosts", [0, 1, 2])
def test_restricted_states_write_back_the_mesh(ghosts: int, mesh: em.Mesh) -> None:
    merged = em.Mesh(np.full(GRID.shape, np.nan), np.full(GRID.shape, np.nan))
    for part in BLOCKS.parts:
        window = SubdomainWindow(BLOCKS, part, ghosts)
        state = window.restrict(mesh)
        assert state.x.shape == window.shape
        assert window.distance(state, mesh) == (0.0, 0.0)
        window.write(state, merged, part.owned)
        state.x[:] = 0.0  # a state has memory of its own
    assert np.array_equal(merged.x, mesh.x)
    assert np.array_equal(merged.y, mesh.y)


def test_the_distance_does_not_look_at_ghosts(mesh: em.Mesh) -> None:
    window = SubdomainWindow(BLOCKS, BLOCKS.at(1, 0), 1)
    state = window.restrict(mesh)
    state.x[0] += 9.0
    state.y[:, -1] += 9.0
    assert window.distance(state, mesh) == (0.0, 0.0)
    state.x[1, 0] += 0.25
    state.y[2, 1] -= 0.5
    assert window.distance(state, mesh) == (0.25, 0.5)
