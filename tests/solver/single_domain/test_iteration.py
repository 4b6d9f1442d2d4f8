"""Nested iteration: the mesh of Newton's method, in a number of sweeps that does not grow with the points."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh.single_domain import iteration
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.steps import SHARE, TIGHT
from solver.sweeps.windows import distance


def test_newton_steps_of_the_nested_iteration() -> None:
    """Counts for tanh20: each level starts from the coarser mesh and needs fewer steps."""
    last = {record.grid.n_xi: record for record in single_domain_steps(problem("tanh20", 65), sweeps=False)}
    assert [last[n].step for n in (17, 33, 65)] == [8, 4, 4]
    assert all(record.converged for record in last.values())
    assert all(0.40 < record.mesh.min_jacobian < 0.42 for record in last.values())


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_mesh_is_that_of_newton(name: str, boundary: em.Boundary) -> None:
    case = problem(name, 49, 41, boundary=boundary, b=0.1)
    *_, fast = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(case, sweeps=False)
    if reference.relaxation.is_none:
        assert fast.relaxation.is_none
        assert distance(fast.mesh, reference.mesh) < 1e-9
    assert reference.relaxation.is_none or boundary is not em.Boundary.TRACE


def test_it_converges_on_all_functions_with_the_trace_condition() -> None:
    for name in FUNCTIONS:
        *_, last = iteration.single_domain_steps(problem(name, 65))
        assert last.converged
        assert last.residual < TIGHT, "the finest level was not solved by sweeps to their tolerance"
        assert last.algebraic_error > 0.0, "sweeps, not Newton steps"


def test_sweeps_do_not_grow_with_the_number_of_points() -> None:
    case = problem("tanh20", 257)
    tight = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case)}
    assert tight[257] <= 11
    usual = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)}
    assert usual == {17: 9, 33: 2, 65: 2, 129: 2, 257: 1}


@pytest.mark.parametrize("name", ["tanh20", "paper", "ring", "wave"])
def test_the_usual_mode_leaves_a_fifth_of_the_discretisation_error(name: str) -> None:
    """Both errors against meshes that know better: the tight one of the same grid, and the tight one of a finer."""
    case, finer = problem(name, 129), problem(name, 513)
    *_, usual = iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)
    *_, tight = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(finer)
    exact = em.Mesh(reference.mesh.x[::4, ::4], reference.mesh.y[::4, ::4])
    algebraic, discretization = distance(usual.mesh, tight.mesh), distance(tight.mesh, exact)
    assert algebraic <= SHARE * discretization
    assert usual.discretization_error == pytest.approx(discretization, rel=0.5)
    assert algebraic > 0.0, "the tight mode would have been no dearer"


@pytest.mark.parametrize("u", ["tanh(20*(x + y/2 - 0.6))", "tanh(20*(y - 0.5 - 0.25*sin(2*pi*x)))"])
def test_half_the_monitor_leads_up_to_one_on_which_sweeps_fail(u: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression(u)), grid=em.Grid(n_xi=33, n_eta=33))

    def strengths() -> list[float]:
        seen: list[float] = []
        solution = em.solve(problem, observe=lambda step: seen.append(step.strength))
        assert solution.status is em.Status.CONVERGED
        assert solution.certificate.relaxed == ()
        return sorted(set(seen))

    with monkeypatch.context() as patch:
        patch.setattr(iteration, "_factorised", None)  # no Newton step is needed
        assert strengths() == [0.5, 1.0]
        patch.setattr(iteration, "_weaker", lambda *_: iter(()))
        with pytest.raises(TypeError):  # but for what is tested here
            strengths()
