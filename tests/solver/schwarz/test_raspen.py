"""Newton's method for the fixed point of the Schwarz iteration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.acceleration import Raspen, Slope
from equimesh.schwarz.functionals import FunctionalSubdomains
from equimesh.schwarz.merged_mesh import InOneProcess
from equimesh.schwarz.subdomains import Subdomains
from solver.schwarz.bent import bent, yielding_subdomains

KINDS = [em.Classical(), em.LinearRobin(), em.NonlinearRobin(), em.Optimized(data=em.LineData.LOCAL)]


CASES = [(kind, em.Boundary.TRACE) for kind in KINDS] + [(em.Optimized(), boundary) for boundary in em.Boundary]


@pytest.mark.parametrize(("kind", "boundary"), CASES, ids=lambda case: getattr(case, "name", case))
def test_the_derivative_of_an_iteration_is_exact(kind: em.TransmissionCondition, boundary: em.Boundary) -> None:
    """The remainder of the linearised iteration falls by 4 when the step is halved."""
    case = problem("paper", 16, 13, boundary=boundary)
    decomposition = em.Decomposition(grid=case.grid, subdomains=(2, 2), overlap=3)
    if isinstance(kind, em.Optimized):
        found: Subdomains = yielding_subdomains(case, decomposition, kind)
    else:
        found = FunctionalSubdomains(case, InOneProcess(decomposition), kind, em.LocalSolver.NEWTON)

    def iterated(mesh: em.Mesh) -> tuple[np.ndarray, list[em.Mesh]]:
        found.restart(mesh)
        found.begin(mesh)
        outcomes = [found.solve(k) for k in range(len(found.windows))]
        assert all(outcome.solution.converged and not outcome.classical for outcome in outcomes)
        states = [outcome.solution.mesh for outcome in outcomes]
        merged = em.Mesh(mesh.x.copy(), mesh.y.copy())
        for window, state in zip(found.windows, states, strict=True):
            window.write(state, merged, window.part.owned)
        return np.stack([merged.x, merged.y]), states

    mesh = bent(case, 0.002)
    change = [bent(case, size) for size in (0.0, 1.0)]
    x, y = change[1].x - change[0].x + np.sin(8 * mesh.y) * np.sin(np.pi * mesh.x), change[1].y - change[0].y
    steps = (2e-4, 1e-4)
    results = [iterated(em.Mesh(mesh.x + h * x, mesh.y + h * y))[0] for h in steps]
    value, states = iterated(mesh)
    slope = np.stack(Slope(found, mesh, states)((x, y)))
    remainders = [abs(result - value - h * slope).max() for h, result in zip(steps, results, strict=True)]
    assert abs(slope).max() > 0.1
    assert 3.7 < remainders[0] / remainders[1] < 4.3


@pytest.mark.parametrize("kind", [em.Classical(), em.Optimized()], ids=lambda kind: kind.name)
def test_newton_for_the_fixed_point_converges_quadratically(kind: em.TransmissionCondition) -> None:
    settings = em.Schwarz(subdomains=(3, 1), transmission=kind, acceleration="newton", compare_single_domain=True)
    solution = em.solve(problem("sine", 17), settings)
    errors = [record.error for record in solution.iterations]
    assert solution.status is em.Status.CONVERGED
    assert next(k for k, error in enumerate(errors) if error < 1e-10) <= 5
    for before, error in pairwise(errors[1:]):
        assert error < max(300 * before**2, 1e-11)
    first = solution.iterations[1]
    assert first.accelerated
    assert 0 < first.products < 50
    assert all(record.newton_steps and not record.sweeps for record in first.subdomains)
    assert solution.convergence()["iterations"][1]["products"] == first.products


def test_a_step_that_folds_is_halved_and_then_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    case = problem("paper", 13)
    start, result = em.Mesh.uniform(case.grid), bent(case, 0.0)
    step = np.concatenate([(result.x - start.x).ravel(), (result.y - start.y).ravel()])
    raspen = Raspen(yielding_subdomains(case, em.Decomposition(grid=case.grid), em.Optimized()), 0.0)
    monkeypatch.setattr("equimesh.schwarz.acceleration.Slope", lambda *_: None)
    for factor, share in ((1.0, 1.0), (8.0, 0.125), (1000.0, None)):
        monkeypatch.setattr(Raspen, "_step", lambda *_, factor=factor: factor * step)
        found = raspen.combine(start, result, [])
        if share is None:
            assert found is None
        else:
            assert not found.is_folded
            scale = np.ptp(found.x - start.x) / np.ptp(result.x - start.x)
            assert factor * share <= scale < 4.0
