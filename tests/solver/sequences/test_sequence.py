"""Meshes that follow a solution in time, in one process."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError

FRONT = "tanh(20*(x + y/2 - 0.6 - t))"
GRID = em.Grid(n_xi=17, n_eta=17)


def front(t: float) -> em.Expression:
    return em.Expression(FRONT, t=t)


def sequence(kind: Any = em.LeastError, **options: Any) -> em.Sequence:
    return em.Sequence(em.Problem(monitor=kind(u=front(0.0)), grid=GRID), **options)


def test_a_step_follows_nodal_values_and_carries_fields() -> None:
    meshes = sequence()
    before = meshes.mesh
    fields = {
        "u": front(0.03).evaluate(before.x, before.y)[0],
        "mass": em.MeshValues(np.ones((16, 16)), transfer="conservative", location="cells"),
    }
    step = meshes.step(fields["u"], fields)
    assert step.mesh is meshes.mesh is step.solution.mesh
    assert step.number == meshes.number == 1
    assert np.array_equal(before.x + step.velocity[..., 0], step.mesh.x)
    assert np.abs(step.fields["u"] - front(0.03).evaluate(step.mesh.x, step.mesh.y)[0]).max() < 0.06
    assert np.abs(step.fields["mass"] - 1.0).max() < 1e-13
    assert step.certificate.interpolation.gain_l2 > 3.0
    assert step.moved > 0.0


@pytest.mark.parametrize("kind", [em.Auto, em.ArcLength, em.Curvature])
def test_all_kinds_of_monitor_follow_u(kind: Any) -> None:
    meshes = sequence(kind)
    step = meshes.step("tanh(9*(x - y))")
    assert isinstance(meshes.problem.monitor, kind)
    assert step.status.succeeded


def test_settings_change_midway() -> None:
    meshes = sequence()
    weight = em.Weight(rho=em.Expression("1 + 9*exp(-20*((x - 0.5)**2 + (y - 0.5)**2))"))
    assert meshes.step(weight).status.succeeded
    assert meshes.problem.monitor.rho is weight.rho  # from now on
    step = meshes.step("1 + 4*x", {"u": meshes.mesh.x}, grid=em.Grid(n_xi=13, n_eta=21))
    assert step.mesh.x.shape == step.fields["u"].shape == (13, 21)
    assert step.velocity is None
    assert np.abs(step.fields["u"] - step.mesh.x).max() < 1e-12
    several = meshes.step((em.ArcLength(u=front(0.0)), em.Curvature(u=front(0.1))))
    assert several.status.succeeded


def test_a_schwarz_iteration_follows_as_well() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=front(0.0)), grid=GRID)
    step = em.Sequence(problem, em.Schwarz(subdomains=(2, 1))).step(front(0.01))
    assert step.solution.schwarz is not None
    assert step.status is em.Status.CONVERGED


def test_a_sequence_begins_with_a_mesh_or_a_solution() -> None:
    solution = em.solve(em.Problem(monitor=em.LeastError(u=front(0.0)), grid=GRID), threads=1)
    assert em.Sequence(solution.problem, solution=solution).mesh is solution.mesh
    ring = em.Problem(monitor=em.ArcLength(u=front(0.0)), grid=GRID, domain=em.AnnulusSector())
    first = em.solve(ring, threads=1).mesh
    step = em.Sequence(ring, mesh=first).step(ring.monitor)
    assert np.abs(step.velocity).max() < 1e-2


def test_a_mesh_that_was_written_into_is_refused() -> None:
    meshes = sequence(em.ArcLength)
    step = meshes.step(front(0.01))
    step.mesh.x[4, 4] += 1e-3
    with pytest.raises(InputError, match="written into"):
        meshes.step(front(0.02))
    step.mesh.x[4, 4] = meshes._nodes[4 * 17 + 4, 0]
    assert meshes.step(front(0.02)).number == 2


def test_smoothing_in_time_keeps_a_share_of_the_mesh_before() -> None:
    plain, smooth = sequence(), sequence(smoothing=0.5)
    before = plain.mesh
    one, other = plain.step(front(0.05)), smooth.step(front(0.05))
    assert np.abs(other.mesh.x - 0.5 * (one.mesh.x + before.x)).max() < 1e-12
    assert other.certificate.interpolation.gain_l2 > 1.0


def test_a_smoothed_mesh_does_not_claim_to_be_converged() -> None:
    plain, smooth = sequence(em.ArcLength), sequence(em.ArcLength, smoothing=0.9)
    one, other = plain.step(front(0.3)), smooth.step(front(0.3))
    assert one.status is em.Status.CONVERGED
    assert other.status is em.Status.COMPLETED
    assert "smoothing = 0.9" in other.solution.message
    assert other.certificate.equation_residual > 100 * one.certificate.equation_residual
    assert other.certificate.algebraic_error is other.certificate.discretization_error is None


def test_a_front_that_outruns_its_cells_is_refused_on_request() -> None:
    meshes = sequence(outrun="refuse", max_move=0.5)
    before = meshes.mesh
    with pytest.raises(InputError, match=r"would move by .* smaller time steps; the mesh before is kept") as caught:
        meshes.step(front(0.3))
    assert caught.value.field == "u"
    assert meshes.mesh is before
    assert meshes.number == 0


def test_the_first_step_from_a_given_mesh_is_told_in_place_of_refused() -> None:
    meshes = sequence(mesh=em.Mesh.uniform(GRID), outrun="refuse", max_move=0.01)
    assert any("more than max_move = 0.01" in warning for warning in meshes.step(front(0.0)).warnings)
    with pytest.raises(InputError, match="would move by"):
        meshes.step(front(0.1))


def test_a_front_that_has_left_its_cells_is_told() -> None:
    meshes = sequence()
    mesh = meshes.mesh
    step = meshes.step(np.where(mesh.x < 0.2, -1.0, 1.0))
    assert any("outrun its cells" in warning for warning in step.warnings)


def test_a_failed_solve_keeps_the_last_good_mesh() -> None:
    steep = em.ArcLength(u=em.Expression("tanh(300*((x-0.5)**2 + (y-0.5)**2 - 0.09))"), a=1.0, b=0.0)
    meshes = sequence(em.ArcLength, allow_relaxed=False)
    before = meshes.mesh
    with pytest.raises(em.SolveError):
        meshes.step(steep)
    quiet = em.Sequence(meshes.problem, solution=meshes.solution, allow_relaxed=False, check=False)
    step = quiet.step(steep, {"u": before.x})
    assert not step.status.succeeded
    assert quiet.mesh is before is step.mesh
    assert np.array_equal(step.fields["u"], before.x)
    assert not step.velocity.any()
    assert quiet.number == 0


def test_integrals_that_bounds_do_not_allow_to_keep_are_told() -> None:
    problem = em.Problem(monitor=em.LeastError(u=front(0.0)), grid=GRID, domain=em.AnnulusSector())
    meshes = em.Sequence(problem)
    step = meshes.step(front(0.3), {"one": em.MeshValues(np.ones(GRID.shape), transfer="conservative")})
    assert any("The integral of one changed" in note for note in step.notes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"smoothing": 1.0}, "smoothing"),
        ({"max_move": 0.0}, "max_move"),
        ({"outrun": "ignore"}, "choose 'substeps' or 'refuse'"),
        ({"mesh": em.Mesh(*np.zeros((2, 17, 17)))}, "min_jacobian"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        sequence(**options)


def test_fields_that_do_not_fit_are_refused_before_the_solve() -> None:
    meshes = sequence()
    with pytest.raises(SamplesError, match="rho has shape"):
        meshes.step(front(0.01), {"rho": np.zeros((16, 16))})
    with pytest.raises(SamplesError, match="NaN"):
        meshes.step(np.full(GRID.shape, np.nan))
    assert meshes.number == 0


def test_cells_do_not_become_flatter_from_step_to_step() -> None:
    ring = "tanh(20*((x - 0.5 - t)**2 + (y - 0.5)**2 - 0.09))"
    problem = em.Problem(monitor=em.LeastError(u=em.Expression(ring, t=0.0)), grid=em.Grid(n_xi=25, n_eta=25))
    meshes = em.Sequence(problem)
    for number in range(1, 9):
        step = meshes.step(em.Expression(ring, t=0.004 * number).evaluate(meshes.mesh.x, meshes.mesh.y)[0])
    assert step.solution.angles.smallest > 15.0
