"""What is made of several iterations, by setting."""

from __future__ import annotations

import itertools
from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.acceleration import Accelerator, Raspen, Slope, accelerator
from equimesh.schwarz.functionals import FunctionalSubdomains
from equimesh.schwarz.iteration import subdomains_of
from equimesh.schwarz.line_corrections import CorrectionResult
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.subdomains import Subdomains
from solver.schwarz.bent import bent, yielding_subdomains
from solver.schwarz.runs import PAPER, WHOLE
from solver.schwarz.solved import solved

MESHES = [bent(PAPER, size) for size in (4e-3, 2e-3, 1.2e-3)]


def made(kind: em.Acceleration) -> Accelerator:
    settings = em.Schwarz(acceleration=kind)
    return accelerator(settings, WHOLE, lambda: subdomains_of(PAPER, WHOLE, settings, enough=0.0, threads=1), 1e-14, 1)


def test_unaccelerated_iterations_stay_as_they_are() -> None:
    corrected = CorrectionResult(MESHES[1], 0.01, 0.1, 1)
    found = made(em.Acceleration.NONE).apply(MESHES[0], corrected, solved(MESHES[1]), 0.0)
    assert found.mesh is MESHES[1]
    assert not found.is_combined


def combined_by_anderson(*, deviation: float = 0.01, estimate: float = 0.1, forget: bool = False) -> bool:
    """Whether the second of two iterations is combined with the first."""
    anderson, found = made(em.Acceleration.ANDERSON), None
    for before, after in itertools.pairwise(MESHES):
        if found is not None and forget:
            anderson.forget()
        found = anderson.apply(before, CorrectionResult(after, deviation, estimate, 1), solved(after), 1e-6)
    assert found.is_combined == (found.mesh is not MESHES[2])
    return found.is_combined


def test_anderson_combines_near_the_solution_as_long_as_it_is_needed() -> None:
    assert combined_by_anderson()
    assert not combined_by_anderson(deviation=0.2), "far away earlier changes say nothing of later ones"
    assert not combined_by_anderson(estimate=1e-7), "the error that is left is small enough"
    assert not combined_by_anderson(forget=True)


@pytest.mark.parametrize("failure", [{"stalled": True}, {"classical": True}], ids=str)
def test_newton_wants_what_all_subdomains_solved(failure: dict[str, bool]) -> None:
    corrected = CorrectionResult(MESHES[1])
    found = made(em.Acceleration.NEWTON).apply(MESHES[0], corrected, solved(MESHES[1], **failure), 0.0)
    assert np.array_equal(found.mesh.x, MESHES[1].x)
    assert (found.is_combined, found.products) == (False, 0)


# Newton's method for the fixed point of the Schwarz iteration.


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
        found = FunctionalSubdomains(case, MergedMeshes(decomposition), kind, em.LocalSolver.NEWTON)

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
