"""Newton's method for subdomains whose interfaces yield, and for the fixed point of the Schwarz iteration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import NewtonSolution
from equimesh.schwarz.functionals.subdomains import FunctionalSubdomains
from equimesh.schwarz.local_sweeps import SubdomainSweeps
from equimesh.schwarz.optimized import sides as yielding
from equimesh.schwarz.optimized.subdomains import YieldingSubdomains
from equimesh.schwarz.port import Subdomains
from equimesh.schwarz.raspen import Raspen, Slope
from equimesh.single_domain import iteration as single_domain

SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))


def bent(case: em.Problem, size: float) -> em.Mesh:
    """The solution with all nodes moved smoothly, those on sides along them."""
    *_, step = single_domain.iterate(case)
    x, y = step.mesh.x, step.mesh.y
    return em.Mesh(
        x + size * np.sin(np.pi * x) * np.cos(2 * y + x),
        y + size * np.sin(np.pi * y) * np.cos(3 * x - y),
    )


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return float(max(abs(one.x - other.x).max(), abs(one.y - other.y).max()))


def yielding_subdomains(
    case: em.Problem, decomposition: em.Decomposition, condition: em.Optimized
) -> YieldingSubdomains:
    """All subdomains with the optimized condition, solved by Newton's method."""
    return YieldingSubdomains(case, decomposition, condition, em.LocalSolver.NEWTON, enough=0.0, threads=1)


def check_against_sweeps(case: em.Problem, parts: tuple[int, int], data: em.LineData = em.LineData.LINE_SUMS) -> None:
    """Newton's method finds what sweeps without end converge to, in every subdomain."""
    decomposition = em.Decomposition(grid=case.grid, subdomains=parts, overlap=3)
    mesh = bent(case, 0.01)
    found = yielding_subdomains(case, decomposition, em.Optimized(data=data))
    found.begin([], mesh)
    for k, window in enumerate(found.windows):
        start, sides = found.received(k)
        sweeps = SubdomainSweeps(case, window.shape, yielding.frame(window, case.grid.shape))
        swept = sweeps.solve(window.restrict(mesh), sides.rest, accuracy=1e-14, most=400)
        newton = found.solve(k).solution
        assert newton.converged
        assert not newton.swept
        assert distance(newton.mesh, swept.mesh) < 1e-10
        assert distance(newton.mesh, start) > 1e-3


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("parts", [(3, 1), (1, 3), (3, 3)], ids=str)
def test_newton_finds_what_sweeps_converge_to(boundary: em.Boundary, parts: tuple[int, int]) -> None:
    check_against_sweeps(problem("paper", 18, 15, boundary=boundary), parts)


@pytest.mark.parametrize("data", em.LineData)
def test_newton_finds_what_sweeps_converge_to_on_a_domain(data: em.LineData) -> None:
    monitor = em.Weight(rho=em.Expression("1 + 2*exp(-10*((x - 0.4)**2 + (y - 0.6)**2))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=15, n_eta=18), domain=SECTOR)
    check_against_sweeps(case, (3, 3), data)


def test_newton_helps_where_sweeps_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_self: SubdomainSweeps, start: em.Mesh, *_: object, **__: object) -> NewtonSolution:
        return NewtonSolution(start, 3, np.inf, converged=False, swept=True)

    monkeypatch.setattr(SubdomainSweeps, "solve", fail)
    settings = em.Schwarz(subdomains=(2, 2), line_correction=0)
    solution = em.solve(problem("paper", 17), settings)
    assert solution.status is em.Status.CONVERGED
    records = [record for iteration in solution.iterations[1:] for record in iteration.subdomains]
    assert any(record.newton_steps for record in records)
    assert not any(record.stalled or record.sweeps for record in records)


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
        found = FunctionalSubdomains(case, decomposition, kind, em.LocalSolver.NEWTON)

    def iterated(mesh: em.Mesh) -> tuple[np.ndarray, list[em.Mesh]]:
        found.begin([window.restrict(mesh) for window in found.windows], mesh)
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
    monkeypatch.setattr("equimesh.schwarz.raspen.Slope", lambda *_: None)
    for factor, share in ((1.0, 1.0), (8.0, 0.125), (1000.0, None)):
        monkeypatch.setattr(Raspen, "_step", lambda *_, factor=factor: factor * step)
        found = raspen.combined(start, result, [])
        if share is None:
            assert found is None
        else:
            assert not found.is_folded
            scale = np.ptp(found.x - start.x) / np.ptp(result.x - start.x)
            assert factor * share <= scale < 4.0


@pytest.mark.parametrize(
    ("more", "field"),
    [({"ordering": "alternating"}, "schwarz.ordering"), ({"line_correction": 1}, "schwarz.line_correction")],
)
def test_newton_is_refused_where_its_derivative_is_not_known(more: dict[str, object], field: str) -> None:
    with pytest.raises(em.InputError, match="newton") as caught:
        em.Schwarz(acceleration="newton", **more)
    assert caught.value.field == field
