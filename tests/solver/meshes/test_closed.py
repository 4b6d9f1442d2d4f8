"""Meshes with closed lines: working memory, finer grids, and nodes that are one."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.nested import (
    Closed,
    closed_mesh,
    distance_closed,
    interpolated_closed,
    padded,
    padded_shape,
    prolong_closed,
    tied_nodes,
    unpadded,
)

CASES = [(True, False), (False, True), (True, True)]


def waved(n: int, closed: Closed, shift: float = 0.0) -> em.Mesh:
    """A smooth mesh with bent seams; ``shift`` is where its lines begin."""
    line = np.linspace(0.0, 1.0, n)
    xi, eta = np.meshgrid(line + shift * closed[0], line + shift * closed[1], indexing="ij")
    bump = np.sin(2 * np.pi * xi) * np.sin(2 * np.pi * eta)
    return closed_mesh(em.Mesh(xi + 0.05 * bump + 0.03 * closed[0], eta + 0.04 * bump), closed)


@pytest.mark.parametrize("closed", CASES)
def test_working_memory_begins_with_the_nodes_before_the_seam(closed: Closed) -> None:
    mesh = waved(9, closed)
    memory = padded(mesh, closed)
    assert memory.x.shape == padded_shape(mesh.grid.shape, closed)
    back = unpadded(memory.x, memory.y, closed)
    assert back.distance(mesh) == 0.0
    if closed[0]:
        assert np.array_equal(back.x[-2], memory.x[0, int(closed[1]) :] + 1.0)


@pytest.mark.parametrize("closed", CASES)
@pytest.mark.parametrize("n", [33, 30])
def test_finer_meshes_do_not_depend_on_where_lines_begin(closed: Closed, n: int) -> None:
    fine = prolong_closed(waved(17, closed), em.Grid(n_xi=n, n_eta=n), closed, waved(9, closed))
    exact = waved(n, closed)
    assert fine.distance(exact) < 4e-4
    other = prolong_closed(waved(17, closed, 0.25), em.Grid(n_xi=n, n_eta=n), closed, waved(9, closed, 0.25))
    if n == 33:
        rolled = np.roll(other.x[:-1, :-1], [8 * c for c in closed], (0, 1))
        assert np.abs((rolled - fine.x[:-1, :-1] + 0.5) % 1.0 - 0.5).max() < 1e-14


@pytest.mark.parametrize("closed", CASES)
def test_the_distance_is_that_at_common_nodes_or_to_the_interpolant(closed: Closed) -> None:
    coarse = waved(17, closed)
    assert distance_closed(waved(33, closed), coarse, closed) < 1e-15
    fine = interpolated_closed(coarse, em.Grid(n_xi=30, n_eta=30), closed)
    assert distance_closed(fine, coarse, closed) < 1e-15
    assert distance_closed(em.Mesh(fine.x + 0.1, fine.y), coarse, closed) == pytest.approx(0.1)


def test_every_copy_is_tied_to_the_first_node() -> None:
    assert tied_nodes((3, 4), (False, False)).shape == (0, 2)
    assert tied_nodes((3, 4), (False, True)).tolist() == [[3, 0], [7, 4], [11, 8]]
    both = dict(tied_nodes((3, 4), (True, True)).tolist())
    assert both == {3: 0, 7: 4, 8: 0, 9: 1, 10: 2, 11: 0}
