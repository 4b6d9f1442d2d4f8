"""The rest of every line beyond an interface: its length, and how that follows the interface."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.decomposition import SubdomainWindow
from equimesh.schwarz.line_corrections import WholeLineSums
from equimesh.schwarz.optimized import yielding_sides
from solver.schwarz.bent import bent

CASE = problem("paper", 20, 17)
STRIPS = em.Decomposition(grid=CASE.grid, subdomains=(3, 1), overlap=4)
MIDDLE = STRIPS.parts[1]


def rests(mesh: em.Mesh, *, local: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """What lies beyond the two interfaces of the middle strip, its nodes where they are in the merged mesh."""
    window = SubdomainWindow(STRIPS, MIDDLE, 1)
    sums = WholeLineSums(CASE, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(mesh)
    state = window.restrict(mesh)
    lower, upper = yielding_sides(CASE.metric, window, state, sums, local=local).rest(state.x, state.y)[0]
    return lower, upper


def test_where_nothing_moved_the_rest_is_what_was_summed() -> None:
    mesh = bent(CASE, 0.01)
    sums = WholeLineSums(CASE, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(mesh)
    lower, upper = rests(mesh)
    assert lower[1:-1] == pytest.approx(sums.beyond_point(0, 0, MIDDLE.columns[0])[1:-1])
    assert upper[1:-1] == pytest.approx(sums.beyond_point(0, 1, MIDDLE.columns[-1])[1:-1])


def test_on_an_equidistributed_mesh_one_edge_speaks_for_all() -> None:
    solution = em.solve(CASE, mode=em.Mode.TIGHT).reference
    for whole, local in zip(rests(solution), rests(solution, local=True), strict=True):
        assert local[1:-1] == pytest.approx(whole[1:-1], rel=1e-7)


@pytest.mark.parametrize("end", [0, 1])
def test_the_rest_follows_the_interface_as_the_sums_do(end: int) -> None:
    """Where the rest stays equidistributed while the interface moves; here with a constant metric, exactly so."""
    flat = problem("paper", 20, 17, a=0.0)
    window, uniform = SubdomainWindow(STRIPS, MIDDLE, 1), em.Mesh.uniform(flat.grid)
    point = MIDDLE.columns[-1 if end else 0]
    sums = WholeLineSums(flat, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(uniform)
    state = window.restrict(uniform)
    found = yielding_sides(flat.metric, window, state, sums, local=False)
    step = 1e-4
    moved = state.x.copy()
    moved[-2 if end else 1] += step
    # N edges of length L / N: the sum of their squares is L^2 / N.
    edges, length = (19 - point, 1 - point / 19) if end else (point, point / 19)
    new = (length - step if end else length + step) ** 2 / edges
    assert found.rest(moved, state.y)[0][end] == pytest.approx(np.full(17, new), abs=2 * step**2)
    assert found.rest(state.x, state.y)[0][end] == pytest.approx(np.full(17, length**2 / edges))
