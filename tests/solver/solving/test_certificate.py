"""The certificate: numbers that are true of the mesh, also of one that is no success."""

from __future__ import annotations

import json

import pytest

import equimesh as em
from cases import problem


def on_ring(n_xi: int, n_eta: int) -> em.Problem:
    """So few points around a ring that a valid mesh of the reference square folds on it."""
    monitor = em.ArcLength(u=em.Expression("tanh(3*(x - y))"), b=0.0, scaled=False)
    domain = em.AnnulusSector(radii=(0.1, 1.0), angles=(0.0, 355.0))
    return em.Problem(monitor=monitor, grid=em.Grid(n_xi=n_xi, n_eta=n_eta), domain=domain)


def test_a_mesh_that_folds_on_its_domain_is_no_success_and_says_what_to_do() -> None:
    solution = em.solve(on_ring(9, 4), check=False)
    assert solution.status is em.Status.FOLDED
    assert "add grid points" in solution.message.lower()
    summary = json.loads(json.dumps(solution.certificate.summary(), allow_nan=False))
    assert summary["status"] == "folded"
    assert summary["min_jacobian"] < 0.0


def test_the_error_is_not_told_where_it_cannot_be_known() -> None:
    """A grid with few points in one direction has no coarser grid in that direction to compare with."""
    flat = em.Problem(monitor=problem("tanh20", 9).monitor, grid=em.Grid(n_xi=5, n_eta=65))
    certificate = em.solve(flat).certificate
    assert certificate.discretization_error is None
    assert certificate.equation_residual < 1e-9, "without an estimate the mesh is solved tightly"
    assert em.solve(problem("tanh20", 33)).certificate.discretization_error is not None


def test_a_constant_added_to_u_does_not_matter() -> None:
    monitors = [em.ArcLength(u=em.Expression(f"{offset} + sin(9*x*y)"), scaled=False) for offset in ("0", "1e6")]
    plain, lifted = (em.solve(em.Problem(monitor=m, grid=em.Grid(n_xi=33, n_eta=33))) for m in monitors)
    assert plain.status is lifted.status is em.Status.CONVERGED
    assert abs(plain.mesh.x - lifted.mesh.x).max() < 1e-5


def test_what_is_not_finite_is_named_and_warns_nobody() -> None:
    solution = em.solve(
        em.Problem(monitor=em.ArcLength(u=em.Expression("sqrt(x)"), scaled=False), grid=em.Grid(n_xi=9, n_eta=9)),
        check=False,
    )
    assert solution.status is em.Status.NEWTON_FAILED
    assert "gradient of u is not finite" in solution.message
    assert solution.certificate.algebraic_error is None
    assert solution.certificate.discretization_error is None


def test_where_the_uniform_mesh_is_exact_that_is_said() -> None:
    bilinear = em.Problem(monitor=em.ArcLength(u=em.Expression("x*y"), scaled=False), grid=em.Grid(n_xi=17, n_eta=17))
    (warning,) = em.solve(bilinear).certificate.warnings
    assert "exactly" in warning


def test_a_uniform_start_has_a_largest_grid() -> None:
    with pytest.raises(em.InputError, match="start nested"):
        em.solve(problem("paper", 300), initial=em.Initial.UNIFORM)
    for threads in ("2", 2.0, True):
        with pytest.raises(em.InputError, match="whole number"):
            em.solve(problem("paper", 9), threads=threads)  # type: ignore[arg-type]
