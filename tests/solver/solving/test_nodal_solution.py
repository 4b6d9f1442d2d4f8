"""The solution of one round of adapting."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.rounds.round import adapt_round
from equimesh.solving.least_error import NOT_BETTER
from equimesh.testing.geometries import l_shape

GRID = em.Grid(n_xi=17, n_eta=17)
NODES = em.Mesh.uniform(GRID)
VALUES = np.tanh(10.0 * (NODES.x + NODES.y / 2 - 0.75))


def solved(values: np.ndarray, norm: str = "l2") -> em.Solution:
    monitor = em.NodalSolution(u=em.NodalField(mesh=NODES, values=values), norm=norm)
    return em.solve(em.Problem(monitor=monitor, grid=GRID))


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_solution_is_the_mesh_of_the_round(norm: str) -> None:
    solution, found = solved(VALUES, norm), adapt_round(NODES, VALUES, norm=norm)
    assert solution.status is em.Status.COMPLETED
    assert np.array_equal(solution.mesh.x, found.mesh.x)
    assert np.array_equal(solution.mesh.y, found.mesh.y)
    estimate = solution.certificate.estimate
    assert estimate is not None
    assert (estimate.l2, estimate.h1) == (found.estimate, found.estimate_h1)
    assert (estimate.unresolved, estimate.moved_cells) == (found.unresolved, found.moved_cells)
    first, *others = solution.comparison
    assert (first.settings["start"], first.chosen, any(one.chosen for one in others)) == (found.chosen, True, False)
    gains = [one.gain_l2 if norm == "l2" else one.gain_h1 for one in solution.comparison]
    assert gains == sorted(gains, reverse=True)
    assert solution.certificate.equation_residual is None
    assert solution.certificate.summary()["estimate"]["l2"] == found.estimate
    assert "of the given values, on their own mesh" in str(solution.certificate)


def test_values_of_a_linear_function_keep_their_mesh() -> None:
    solution = solved(2.0 * NODES.x - NODES.y)
    assert solution.mesh.distance(NODES) == 0.0
    assert solution.note == NOT_BETTER


def test_what_a_round_cannot_have() -> None:
    monitor = em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES))
    with pytest.raises(em.InputError, match="the grid has 9 x 9 points, the values are 17 x 17"):
        em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=9)))
    with pytest.raises(em.InputError, match="leave the Schwarz settings out"):
        em.solve(em.Problem(monitor=monitor, grid=GRID), em.Schwarz(subdomains=(2, 1)))


def test_on_blocks_the_solution_is_that_of_the_round() -> None:
    domain = l_shape(300)
    mesh = domain.mesh
    values = np.tanh(9 * (mesh.x + mesh.y - 1))
    problem = em.Problem(monitor=em.NodalSolution(u=em.QuadField(mesh=mesh, values=values)), domain=domain)
    solution = em.solve(problem, threads=1)
    found = em.adapt_round(mesh, values, domain)
    assert np.array_equal(solution.mesh.points, found.mesh.points)
    assert solution.estimate is not None
    assert (solution.estimate.l2, solution.status) == (found.estimate, em.Status.COMPLETED)
    assert solution.certificate.comparison[0].chosen
    assert solution.interpolation.gain_l2 > 1.5
    assert solution.data().u.shape == mesh.node_shape


def test_values_on_a_mesh_of_another_kind_are_refused() -> None:
    domain, grid = l_shape(300), em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    of_grid = em.NodalSolution(u=em.NodalField(mesh=grid, values=grid.x))
    of_blocks = em.NodalSolution(u=em.QuadField(mesh=domain.mesh, values=domain.mesh.x))
    with pytest.raises(em.InputError, match="on a mesh of a grid and the domain is in blocks"):
        em.Problem(monitor=of_grid, domain=domain)
    with pytest.raises(em.InputError, match="on a mesh of a grid and the domain is in blocks"):
        em.solve(em.Problem(monitor=of_blocks, grid=grid.grid))
