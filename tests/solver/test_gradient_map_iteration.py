"""Gradient maps of weights, from the coarse grid to the requested one."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh import gradient_map
from equimesh.domains.domain import map_mesh
from equimesh.gradient_map import MAX_DEVIATION, gradient_map_steps
from equimesh.schwarz.iteration import schwarz_iterations
from equimesh.single_domain.level import Step
from equimesh.specs import build

HARD = {
    "peak": "1 + 1000*exp(-200*((x - 0.5)**2 + (y - 0.5)**2))",
    "thin peak": "1 + 1e4*exp(-2000*((x - 0.4)**2 + (y - 0.6)**2))",
    "ring": "1 + 1000*exp(-1000*(hypot(x - 0.5, y - 0.5) - 0.3)**2)",
    "jump": "where((x - 0.5)**2 + (y - 0.5)**2 < 0.04, 1e4, 1)",
    "corner": "1/(1e-4 + x**2 + y**2)",
    "growth": "exp(20*x*y)",
    "line": "1 + 1e4*exp(-(100*(x - y))**2)",
}


def problem(rho: str, n_xi: int = 33, n_eta: int | None = None, domain: em.Domain | None = None) -> em.Problem:
    grid, weight = em.Grid(n_xi=n_xi, n_eta=n_eta or n_xi), em.Weight(rho=em.Expression(rho), map="gradient")
    return em.Problem(monitor=weight, grid=grid, domain=domain or em.Rectangle())


def last(of: em.Problem) -> Step:
    *_, step = gradient_map_steps(of)
    return step


@pytest.mark.parametrize("name", HARD)
def test_steep_weights_are_solved_without_relaxation(name: str) -> None:
    step = last(problem(HARD[name]))
    assert step.converged
    assert step.is_exact
    assert step.residual <= MAX_DEVIATION
    assert not step.mesh.is_folded


def test_a_constant_weight_gives_the_uniform_mesh() -> None:
    mesh = last(problem("7", 12, 20)).mesh
    uniform = em.Mesh.uniform(em.Grid(n_xi=12, n_eta=20))
    assert np.abs(mesh.x - uniform.x).max() < 1e-12
    assert np.abs(mesh.y - uniform.y).max() < 1e-12


@pytest.mark.parametrize("shape", [(40, 171), (129, 65), (4, 5), (17, 17)])
def test_any_grid_has_a_map(shape: tuple[int, int]) -> None:
    steps = list(gradient_map_steps(problem("1 + 50*exp(-20*((x - 0.3)**2 + (y - 0.6)**2))", *shape)))
    assert steps[-1].converged
    assert steps[-1].mesh.x.shape == shape
    assert not any(step.mesh.is_folded for step in steps)
    assert [step.level for step in steps] == sorted(step.level for step in steps)
    assert steps[-1].level == steps[-1].levels - 1


def test_symmetry_of_the_weight_is_that_of_the_mesh() -> None:
    mesh = last(problem("1 + 100*exp(-50*((x - 0.5)**2 + (y - 0.5)**2))")).mesh
    assert np.abs(mesh.x - mesh.y.T).max() < 1e-9
    assert np.abs(mesh.x + mesh.x[::-1] - 1.0).max() < 1e-9


def test_shares_of_the_weight_are_equal_on_a_bent_domain() -> None:
    solution = em.solve(problem("1 + 9*exp(-20*((x - 1)**2 + (y - 1)**2))", 33, 41, em.AnnulusSector()))
    assert solution.status is em.Status.CONVERGED
    assert abs(solution.quality.q_eq.rms - 1.0) < 0.01
    flat = map_mesh(em.Mesh.uniform(solution.problem.grid), em.AnnulusSector())
    uniform = em.measure(flat, solution.problem.monitor)
    assert uniform.q_eq.rms > 1.1


def test_a_weight_that_is_not_reached_is_relaxed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradient_map, "MAX_MOVES", 2)
    solution = em.solve(problem(HARD["ring"]))
    assert solution.status is em.Status.RELAXED
    (relaxed,) = solution.relaxed
    assert relaxed.what == "strength"
    assert 0.0 < relaxed.reached < 1.0
    assert not solution.mesh.is_folded
    monkeypatch.setattr(gradient_map, "MIN_STRENGTH", 0.9)
    failed = em.solve(problem(HARD["ring"]), check=False)
    assert failed.status is em.Status.NEWTON_FAILED
    assert not failed.mesh.is_folded


def test_the_certificate_has_the_deviation_of_the_shares() -> None:
    solution = em.solve(problem(HARD["ring"], 65))
    certificate = solution.certificate
    assert certificate.status is em.Status.CONVERGED
    assert certificate.mode is None
    assert 0.0 < certificate.equation_residual == solution.residual <= MAX_DEVIATION
    assert solution.newton_steps > 3


def test_the_start_does_not_matter_and_subdomains_are_refused() -> None:
    of = problem(HARD["peak"])
    first = em.solve(of)
    again = em.solve(of, initial=first.reference)
    assert np.array_equal(first.mesh.x, again.mesh.x)
    assert again.detours == ()
    with pytest.raises(em.InputError, match="not made of subdomains") as caught:
        em.solve(of, em.Schwarz())
    assert caught.value.field == "schwarz"
    start = em.Mesh.uniform(of.grid)
    with pytest.raises(em.InputError, match="not made of subdomains"):
        next(schwarz_iterations(of, em.Schwarz(), start))


def test_smoothing_keeps_the_map() -> None:
    of = problem("where(x < 0.5, 1, 100)")
    smooth = em.Problem(monitor=em.Smoothed(monitor=of.monitor, radius=0.1), grid=of.grid)
    sharp, wide = em.solve(of), em.solve(smooth)
    assert wide.mode is None
    assert wide.status is em.Status.CONVERGED
    assert wide.quality.size_ratio.max < sharp.quality.size_ratio.max


def test_a_document_with_a_map_and_subdomains_is_refused() -> None:
    document = {"monitor": {"kind": "weight", "rho": {"expression": "1 + x"}, "map": "gradient"}}
    assert build(document).problem.monitor == problem("1 + x").monitor
    with pytest.raises(em.InputError) as caught:
        build({**document, "schwarz": {}})
    assert caught.value.field == "schwarz"
