"""From a problem to a mesh: observers, starts, samples, what is measured, the certificate, and the status."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.mesh import MeshRows
from equimesh.solving.single_domain import MAX_ROUNDING_RESIDUAL
from equimesh.solving.solution import MeasuredMesh
from equimesh.solving.solve import Best, Equidistribute, MinimiseError, Round, method_of
from equimesh.testing.geometries import l_shape
from solver.schwarz.runs import PAPER, assert_same


def test_observer_sees_newton_steps_and_iterations() -> None:
    seen: list[em.Event] = []
    settings = em.Schwarz(tolerance=1e-6, compare_single_domain=True)
    solution = em.solve(PAPER, settings, observe=seen.append)
    assert [e for e in seen if isinstance(e, em.Iteration)] == list(solution.iterations)
    grids = {e.grid for e in seen if isinstance(e, em.Step)}
    assert grids == {em.Grid(n_xi=13, n_eta=11), PAPER.grid}


def test_an_unknown_option_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(TypeError, match=r"solve\(\) has no option 'thread'; did you mean 'threads'\?"):
        em.solve(PAPER, thread=1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="it has initial, mode, allow_relaxed, threads, observe, check"):
        em.solve(PAPER, verbose=True)  # type: ignore[call-arg]


def test_a_spline_of_samples_gives_the_mesh_of_the_function() -> None:
    """Node positions differ by the accuracy of the spline: fourth order in the spacing of the samples."""
    case = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    exact = em.solve(case, mode=em.Mode.TIGHT).mesh
    differences = []
    for samples in (33, 65, 129):
        axis = np.linspace(0, 1, samples)
        (values,) = case.monitor.u.evaluate(*np.meshgrid(axis, axis, indexing="ij"))
        monitor = replace(case.monitor, u=em.GridSamples(x=axis, y=axis, values=values))
        mesh = em.solve(replace(case, monitor=monitor)).mesh
        differences.append(max(abs(mesh.x - exact.x).max(), abs(mesh.y - exact.y).max()))
    assert differences[0] < 2e-5
    assert differences[2] < 3e-8
    assert differences[1] / differences[2] > 8


def test_a_solve_may_start_from_a_mesh() -> None:
    """That of a front a little before, with subdomains and without; another shape, or a folded one, is refused."""
    before, now = (
        em.Problem(
            monitor=em.ArcLength(u=em.Expression("tanh(20*(x + y/2 - 0.75 - t))", t=t)), grid=em.Grid(n_xi=33, n_eta=33)
        )
        for t in (0.0, 1e-3)
    )
    start = em.solve(before, mode=em.Mode.TIGHT).reference
    cold = em.solve(now, mode=em.Mode.TIGHT)
    assert_same(em.solve(now, initial=start, mode=em.Mode.TIGHT), cold, 1e-9)
    assert_same(em.solve(now, initial=start), cold, 1e-3 / 32)
    warm = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=start)
    assert_same(warm, cold, 1e-9)
    assert len(warm.iterations) - 1 <= 3
    far = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=em.Mesh.uniform(now.grid))
    assert_same(far, cold, 1e-9)
    assert "too far from the solution to start from" in far.message
    assert repr(far) == f"<Solution: 33 x 33 points, converged, {len(far.iterations)} iterations>"
    assert repr(cold) == "<Solution: 33 x 33 points, converged>"
    for wrong in (em.solve(PAPER).reference, em.Mesh(start.x[::-1].copy(), start.y)):
        with pytest.raises(em.InputError, match="the mesh to start from"):
            em.solve(now, initial=wrong)


def test_the_method_follows_from_the_monitor_and_has_its_own_settings() -> None:
    u, grid, settings = em.Expression("tanh(9*x)"), em.Grid(n_xi=9, n_eta=9), em.Schwarz(subdomains=(2, 1))
    mesh = em.Mesh.uniform(grid)
    nodal = em.NodalSolution(u=em.NodalField(mesh=mesh, values=mesh.x))
    tight = {"mode": "tight", "allow_relaxed": False}
    equidistribute = Equidistribute(schwarz=settings, mode=em.Mode.TIGHT, allow_relaxed=False)
    for monitor, expected in (
        (em.ArcLength(u=u), equidistribute),
        (em.Auto(u=u), Best(equidistribute=equidistribute)),
        (em.LeastError(u=u), MinimiseError(schwarz=settings)),
    ):
        assert method_of(em.Problem(monitor=monitor, grid=grid), settings, **tight) == expected
    assert method_of(em.Problem(monitor=nodal, grid=grid), **tight) == Round()
    on_blocks = em.Problem(monitor=em.Auto(u=u), domain=l_shape(100))
    assert method_of(on_blocks, em.Schwarz()) == Best(minimise=MinimiseError(schwarz=em.Schwarz()))
    with pytest.raises(em.InputError, match="leave the Schwarz settings out") as caught:
        method_of(em.Problem(monitor=nodal, grid=grid), settings)
    assert caught.value.field == "schwarz"


def test_measures_do_not_depend_on_what_is_read_first() -> None:
    for case in (PAPER, problem("tanh20", 65)):
        first, second = em.solve(case), em.solve(case)
        q_eq, gain = first.data().q_eq, first.certificate.interpolation
        assert np.array_equal(q_eq, first.quality.q_eq.cells)
        assert second.quality.interpolation_error == first.quality.interpolation_error == gain
        assert np.array_equal(second.data().q_eq, q_eq)


def test_what_counts_as_success() -> None:
    assert {status for status in em.Status if status.succeeded} == {
        em.Status.CONVERGED,
        em.Status.RELAXED,
        em.Status.COMPLETED,
    }


def test_each_status_has_a_sentence_of_its_own() -> None:
    sentences = [status.sentence for status in em.Status]
    assert all(sentence.endswith(".") for sentence in sentences)
    assert len({*sentences}) == len(em.Status)


@pytest.mark.parametrize("schwarz", [None, em.Schwarz()], ids=["single domain", "schwarz"])
@pytest.mark.parametrize("size", ["1e11", "1e13", "1e15"])
def test_a_function_that_is_lost_in_rounding_never_counts_as_solved(size: str, schwarz: em.Schwarz | None) -> None:
    u = em.Expression(f"{size} + tanh(20*(x - y**2))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    for mode in em.Mode:
        solution = em.solve(problem, schwarz, mode=mode, check=False)
        assert solution.status is em.Status.NEWTON_FAILED
        assert solution.residual > MAX_ROUNDING_RESIDUAL
        assert "times as large as it varies" in solution.message
        assert solution.message.endswith(
            "Subtract a constant from u, so that its values are not much larger than it varies."
        )
        assert solution.convergence()["iterations"] == []
    with pytest.raises(em.SolveError, match="Subtract a constant"):
        em.solve(problem, schwarz)


def test_a_smaller_constant_is_no_obstacle() -> None:
    u = em.Expression("1e7 + tanh(20*(x - y**2))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    assert em.solve(problem).status is em.Status.CONVERGED


U = em.Expression("tanh(9*(x + y/2 - 0.7))")


def measured(solution: em.Solution, **more: object) -> MeasuredMesh:
    windows = MeshRows.of(solution.mesh), MeshRows.of(solution.reference)
    return MeasuredMesh(problem=solution.problem, mesh=windows[0], reference=windows[1], **more)  # type: ignore[arg-type]


def solved(monitor: em.Monitor, domain: em.Domain | None = None) -> em.Solution:
    grid = em.Grid(n_xi=21, n_eta=17)
    return em.solve(em.Problem(monitor=monitor, grid=grid, domain=domain or em.Rectangle()))


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector()], ids=["square", "sector"])
def test_a_certificate_says_what_is_measured(domain: em.Domain) -> None:
    solution = solved(em.ArcLength(u=U), domain)
    found, certificate = measured(solution), solution.certificate
    assert found.quality().summary() == solution.quality.summary()
    assert found.faces() == certificate.faces
    assert found.min_jacobian() == certificate.min_jacobian
    assert found.deviation(1.0) == pytest.approx(certificate.equation_residual, rel=1e-6)
    errors = solution.interpolation
    assert found.warnings(solution.status, (), errors, found.faces(), found.gains(errors)) == certificate.warnings


def test_known_values_of_u_are_not_evaluated_again() -> None:
    solution, asked = solved(em.ArcLength(u=U)), []

    def values() -> np.ndarray | None:
        asked.append(True)
        return solution.u

    known = measured(solution, u=values)
    assert known.deviation(1.0) == solution.certificate.equation_residual
    assert known.quality(solution.u).summary() == solution.quality.summary()
    known.faces()
    assert len(asked) == 1


@pytest.mark.parametrize("points", [17, 141])
def test_u_at_the_nodes_is_that_of_the_measures(points: int) -> None:
    """On a large mesh it was evaluated with the metric, on a small one with the errors."""
    problem = em.Problem(monitor=em.ArcLength(u=U), grid=em.Grid(n_xi=points, n_eta=points))
    first, second = em.solve(problem), em.solve(problem)
    assert first.quality.u is not None
    assert np.shares_memory(first.u, first.quality.u)
    assert second.u == pytest.approx(first.u, rel=1e-14)
    assert second.quality.summary() == first.quality.summary()
    assert first.quality.without_cells().u is None


def test_only_equidistribution_along_lines_has_a_deviation() -> None:
    least = solved(em.LeastError(u=U))
    assert measured(least).deviation(0.5) is None
    assert least.certificate.equation_residual is None
    mapped = solved(em.Weight(rho=em.Expression("1 + x*y"), map="gradient"))
    assert measured(mapped).deviation(0.5) == 0.5
    assert mapped.certificate.equation_residual == mapped.residual


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
