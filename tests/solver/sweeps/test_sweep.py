"""The chord iteration: the mesh of the reference Newton, for a fraction of the work, on any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh.equations.mesh_equations import Cells
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.nested import interpolate
from equimesh.numerics.threads import thread_count
from equimesh.single_domain import iteration
from equimesh.single_domain.steps import SHARE, TIGHT
from equimesh.sweeps.sweep import Sweep, deviation, memory_needed


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return max(abs(one.x - other.x).max(), abs(one.y - other.y).max())


def sweep_on(case: em.Problem, threads: int = 1) -> Sweep:
    return Sweep(case.metric, case.boundary, case.grid.shape, np.empty(memory_needed(case.grid.shape)), threads)


def disturbed(case: em.Problem, size: float = 0.01) -> em.Mesh:
    uniform, random = em.Mesh.uniform(case.grid), np.random.default_rng(3)
    inside = np.zeros(case.grid.shape)
    inside[1:-1, 1:-1] = size
    noise = [inside * random.standard_normal(case.grid.shape) for _ in range(2)]
    return em.Mesh(uniform.x + noise[0], uniform.y + noise[1])


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_mesh_is_that_of_newton(name: str, boundary: em.Boundary) -> None:
    case = problem(name, 49, 41, boundary=boundary, b=0.1)
    *_, fast = iteration.iterate(case)
    *_, reference = iteration.iterate(case, sweeps=False)
    if reference.relaxation.is_none:
        assert fast.relaxation.is_none
        assert distance(fast.mesh, reference.mesh) < 1e-9
    assert reference.relaxation.is_none or boundary is not em.Boundary.TRACE


def test_it_converges_on_all_functions_with_the_trace_condition() -> None:
    for name in FUNCTIONS:
        *_, last = iteration.iterate(problem(name, 65))
        assert last.converged
        assert last.residual < TIGHT, "the finest level was not solved by sweeps to their tolerance"
        assert last.algebraic_error > 0.0, "sweeps, not Newton steps"


def test_sweeps_do_not_grow_with_the_number_of_points() -> None:
    case = problem("tanh20", 257)
    tight = {step.grid.n_xi: step.step for step in iteration.iterate(case)}
    assert tight[257] <= 11
    usual = {step.grid.n_xi: step.step for step in iteration.iterate(case, mode=em.Mode.DISCRETIZATION)}
    assert usual == {17: 9, 33: 2, 65: 2, 129: 2, 257: 1}


@pytest.mark.parametrize("name", ["tanh20", "paper", "ring", "wave"])
def test_the_usual_mode_leaves_a_fifth_of_the_discretisation_error(name: str) -> None:
    """Both errors against meshes that know better: the tight one of the same grid, and the tight one of a finer."""
    case, finer = problem(name, 129), problem(name, 513)
    *_, usual = iteration.iterate(case, mode=em.Mode.DISCRETIZATION)
    *_, tight = iteration.iterate(case)
    *_, reference = iteration.iterate(finer)
    exact = em.Mesh(reference.mesh.x[::4, ::4], reference.mesh.y[::4, ::4])
    algebraic, discretization = distance(usual.mesh, tight.mesh), distance(tight.mesh, exact)
    assert algebraic <= SHARE * discretization
    assert usual.discretization_error == pytest.approx(discretization, rel=0.5)
    assert algebraic > 0.0, "the tight mode would have been no dearer"


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    """Bit for bit: the strips that are shared out are always the same."""
    case = problem("ring", 301, 257)
    meshes = [list(iteration.iterate(case, threads=threads))[-1].mesh for threads in (1, 2, 3, 1)]
    assert all(np.array_equal(meshes[0].x, mesh.x) and np.array_equal(meshes[0].y, mesh.y) for mesh in meshes[1:])
    sweep = sweep_on(case, threads=3)
    assert sweep._threads == 3
    assert len(sweep._strips) > 2


def test_threads_are_checked() -> None:
    assert thread_count(None) >= 1
    with pytest.raises(em.InputError, match="threads = 0"):
        em.solve(problem("paper", 9), threads=0)


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
def test_deviation_is_that_of_the_equations(domain: em.Domain) -> None:
    """The kernels against the fluxes of the Newton equations, on a mesh that is no solution."""
    case = problem("ring", 9, 12, b=0.3)
    case = em.Problem(monitor=case.monitor, grid=case.grid, domain=domain)
    mesh = disturbed(case)
    window = case.equations().window(case.equations().vector(mesh))
    bottom, top, left, right = (2 * flux.value for flux in Cells(window).fluxes)
    xi, eta = (top[:, :-1] + bottom[:, 1:]) / 2, (right[:-1] + left[1:]) / 2
    expected = max(abs(xi / xi.mean(axis=0) - 1).max(), abs(eta.T / eta.mean(axis=1) - 1).max())
    assert deviation(case.metric, case.boundary, mesh) == pytest.approx(expected, rel=1e-12)


def test_one_sweep_solves_the_leading_part() -> None:
    """With a constant metric only the squares are left out of the leading part: the error falls to its square."""
    case = problem("ring", 14, 11, a=0.0)
    uniform, ratios = em.Mesh.uniform(case.grid), []
    for size in (1e-2, 1e-3):
        bump = size * np.sin(np.pi * uniform.x) * np.sin(np.pi * uniform.y)
        sweep, start = sweep_on(case), em.Mesh(uniform.x + bump, uniform.y - bump)
        found = sweep.correct(start.x, start.y)
        moved = em.Mesh(sweep.new_x, sweep.new_y)
        ratios.append(distance(moved, uniform) / distance(start, uniform))
        assert found.move == pytest.approx(distance(moved, start), rel=1e-12)
    assert ratios[0] < 0.1
    assert ratios[1] < 0.2 * ratios[0]


def test_the_solution_stays_where_it_is() -> None:
    case = problem("tanh20", 33)
    *_, last = iteration.iterate(case)
    assert sweep_on(case).correct(last.mesh.x, last.mesh.y).move < 1e-11


def test_the_sides_move_with_the_interior() -> None:
    """Nodes on the sides go where the equations of the sides want them, also at right angles to a moving interior."""
    for boundary in em.Boundary:
        case = problem("tanh20", 33, boundary=boundary, b=0.5)
        *_, last = iteration.iterate(case)
        equations = case.equations()
        assert abs(equations.residual(equations.vector(last.mesh))).max() < 1e-9 * equations.mean_flux(
            equations.vector(last.mesh)
        )
        assert abs(last.mesh.x[:, 0] - np.linspace(0, 1, 33)).max() > 1e-3


def test_smallest_jacobian_is_that_of_the_mesh() -> None:
    mesh = em.solve(problem("paper", 12)).mesh
    assert smallest_jacobian(mesh.x, mesh.y) * 11 * 11 == pytest.approx(mesh.corner_jacobians().min())
    broken = mesh.x.copy()
    broken[3, 4] = np.nan
    assert np.isnan(smallest_jacobian(broken, mesh.y))
    assert em.Mesh(broken, mesh.y).is_folded


def test_what_is_not_a_number_is_no_convergence() -> None:
    """One bad value on one line: every comparison with it is false, and must not count as a small deviation."""

    class Hole:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            bad = np.where((abs(x - 0.5) < 0.01) & (abs(y - 0.5) < 0.01), np.nan, x)
            return tuple(bad.copy() for _ in range((1, 3, 6)[order]))

    case = em.Problem(monitor=em.ArcLength(u=Hole()), grid=em.Grid(n_xi=9, n_eta=9))
    mesh = em.Mesh.uniform(case.grid)
    found = sweep_on(case).correct(mesh.x, mesh.y)
    assert found.deviation == np.inf
    solution = em.solve(case, check=False)
    assert not solution.status.succeeded
    assert not solution.mesh.is_folded


def test_interpolation_keeps_or_measures() -> None:
    rule = (np.array([0, 0, 0]), np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    coarse, fine = np.array([[0.0, 1.0], [2.0, 5.0]]), np.full((3, 3), 7.0)
    assert interpolate(coarse, *rule, *rule, fine, False) == 7.0
    assert (fine == 7.0).all()
    interpolate(coarse, *rule, *rule, fine, True)
    assert fine == pytest.approx(np.array([[0, 0.5, 1], [1, 2, 3], [2, 3.5, 5]]))


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
