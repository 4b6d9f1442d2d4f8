"""A mesh next to the uniform mesh of its size: against the norms of the whole meshes, and against plain integrals."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.quality import compare_with_uniform
from equimesh.quality.cells import BilinearCells
from equimesh.quality.comparison import ComparedMesh
from equimesh.quality.measures import measure_all

SECTOR = em.AnnulusSector(center=(0.3, -0.4), radii=(0.6, 1.4), angles=(10.0, 100.0))
WAVE = em.Expression("tanh(8*(x - 0.4*y)) + x*y")


def bent(n_xi: int, n_eta: int, domain: em.Domain) -> em.Mesh:
    uniform = em.Mesh.uniform(em.Grid(n_xi=n_xi, n_eta=n_eta))
    moves = np.random.default_rng(1).uniform(-0.3, 0.3, (2, n_xi, n_eta)) / max(n_xi, n_eta)
    return map_mesh(em.Mesh.of_unit_square(uniform.x + moves[0], uniform.y + moves[1]), domain)


def norm(compared: ComparedMesh) -> float:
    area = BilinearCells(compared.mesh).area.reshape(compared.error.shape)
    return float(np.sqrt((compared.error**2 * area).sum()))


def bound(u: em.Field, domain: em.Domain, n: tuple[int, int]) -> em.Monitor:
    return em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=n[0], n_eta=n[1]), domain=domain).monitor


@pytest.mark.parametrize("kind", ["quad", "triangle"])
@pytest.mark.parametrize("domain", [em.Rectangle(), SECTOR], ids=["square", "sector"])
@pytest.mark.parametrize("n", [(14, 11), (65, 60)], ids=str)
def test_the_errors_of_the_cells_sum_to_the_norms_of_both_meshes(
    kind: Literal["quad", "triangle"], domain: em.Domain, n: tuple[int, int]
) -> None:
    mesh, monitor = bent(*n, domain), bound(WAVE, domain, n)
    found = compare_with_uniform(mesh, monitor, domain=domain, kind=kind)
    whole = measure_all(mesh, monitor, domain=domain, kind=kind)
    assert norm(found.adapted) == pytest.approx(whole.interpolation_error.l2, rel=1e-12)
    assert norm(found.uniform) == pytest.approx(whole.interpolation_error.l2_uniform, rel=1e-12)
    assert np.array_equal(found.adapted.q_eq, whole.q_eq.cells)
    plain = map_mesh(em.Mesh.uniform(mesh.grid), domain)
    assert found.uniform.mesh.distance(plain) == 0.0
    assert np.array_equal(found.uniform.q_eq, measure_all(plain, monitor, domain=domain).q_eq.cells)


def test_the_error_of_a_cell_is_that_of_its_own_interpolant() -> None:
    """Of u = x^2 on a rectangle of width h the error is s (1 - s) h^2, of root mean square h^2 / sqrt(30)."""
    x, y = np.meshgrid([0.0, 0.1, 0.4, 0.6, 1.0], [0.0, 0.5, 0.7, 1.0], indexing="ij")
    mesh = em.Mesh(x, y)
    found = compare_with_uniform(mesh, bound(em.Expression("x**2"), em.Rectangle(), (5, 4)))
    expected = np.tile((np.diff(x[:, 0]) ** 2 / np.sqrt(30.0))[:, None], (1, 3))
    assert found.adapted.error == pytest.approx(expected, rel=1e-12)
    assert found.uniform.error == pytest.approx(np.full((4, 3), 0.0625 / np.sqrt(30.0)), rel=1e-12)
    assert found.adapted.u == pytest.approx(x**2)
    assert found.gain is None  # nobody has measured the whole mesh


def test_a_solution_is_compared_on_its_own_cells_and_with_its_own_gain() -> None:
    for cells in ("quad", "triangle"):
        monitor = em.LeastError(u=WAVE, cells=cells)
        solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=14, n_eta=13), domain=SECTOR))
        found, errors = solution.against_uniform, solution.interpolation
        assert found.gain == errors.gain_l2 > 1.0
        assert norm(found.uniform) / norm(found.adapted) == pytest.approx(errors.gain_l2, rel=1e-9)


def test_a_weight_has_no_u_and_no_errors() -> None:
    weight = em.Weight(rho=em.Expression("1 + 5*x"))
    found = em.solve(em.Problem(monitor=weight, grid=em.Grid(n_xi=9, n_eta=8))).against_uniform
    assert (found.adapted.u, found.uniform.error, found.gain) == (None, None, None)
    assert found.adapted.q_eq.max() < found.uniform.q_eq.max()


def test_the_errors_on_a_folded_mesh_are_infinite() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=6))
    mesh.x[2, 2] = 0.9
    monitor = bound(WAVE, em.Rectangle(), (6, 6))
    errors = measure_all(mesh, monitor).interpolation_error
    found = compare_with_uniform(mesh, monitor, interpolation=errors)
    assert found.adapted.error is not None
    assert np.isinf(found.adapted.error).all()
    assert found.uniform.error is not None
    assert np.isfinite(found.uniform.error).all()
    assert found.gain is None
