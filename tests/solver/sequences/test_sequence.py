"""Meshes that follow a solution in time: their steps, what lies between, how far nodes move, and integrals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh.sequences.pursuit import (
    Between,
    blocks_between,
    cells_moved,
    displacement,
    largest_jump,
    mesh_between,
    stays_valid,
)
from equimesh.sequences.sequence import about_integrals
from equimesh.testing import check_field
from equimesh.testing.geometries import l_shape
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import corner, disc, turned

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


def test_a_step_tells_how_its_solve_ended_and_what_to_read() -> None:
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(20*(x-0.4))")), grid=em.Grid(n_xi=9, n_eta=9))
    solution = em.solve(problem, threads=1)
    step = em.SequenceStep(
        number=3,
        mesh=solution.mesh,
        solution=solution,
        fields={},
        velocity=None,
        moved=None,
        substeps=1,
        notes=("Note.",),
    )
    assert step.status is em.Status.COMPLETED
    assert step.certificate.status is step.status
    assert step.warnings == ("Note.", *solution.certificate.warnings)
    assert repr(step) == "<SequenceStep 3: 9 x 9 points, completed>"


def test_u_between_two_times_is_a_field() -> None:
    field = Between(earlier=em.Expression("x*x"), later=em.Expression("sin(y)"), share=0.25)
    check_field(field, ((0.0, 1.0), (0.0, 1.0)))
    (u,) = field.evaluate(np.array([0.5]), np.array([0.3]))
    assert u[0] == 0.75 * 0.25 + 0.25 * np.sin(0.3)


def test_a_smoothed_mesh_has_a_share_of_the_one_before() -> None:
    before, new = smooth_mesh(9), smooth_mesh(9, depth=-0.05)
    mesh = mesh_between(before, new, 0.3)
    assert np.abs(mesh.x - (0.7 * new.x + 0.3 * before.x)).max() < 1e-14


def test_the_share_falls_where_a_cell_would_fold() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    x, y = uniform.x - 0.5, uniform.y - 0.5
    inner = np.pad(np.ones((3, 3)), 1)
    before = em.Mesh(uniform.x + 9.0 * inner * y, uniform.y - 9.0 * inner * x)
    mesh = mesh_between(before, uniform, 0.9)
    assert not mesh.is_folded
    assert 0.0 <= np.abs(mesh.x - uniform.x).max() < 0.9 * 9.0 * 0.25


def test_a_mesh_of_blocks_between_two_is_not_folded() -> None:
    domain = l_shape(300)
    mesh = domain.mesh
    far = mesh.moved(mesh.points[::-1].copy())
    for share in (0.9, 0.5):
        assert not blocks_between(domain, far, mesh, share).is_folded
    assert blocks_between(domain, mesh, mesh, 0.5).distance(mesh) < 1e-12
    shifted = mesh.points.copy()
    shifted[domain.node_curve == -1] += 0.01
    middle = blocks_between(domain, mesh.moved(shifted), mesh, 0.5)
    assert np.abs(middle.points - mesh.points)[domain.node_curve == -1] == pytest.approx(0.005)


def test_moves_are_counted_in_cells() -> None:
    old = em.Mesh.uniform(em.Grid(n_xi=21, n_eta=11))
    new = em.Mesh(old.x + 0.1, old.y - 0.05)
    assert cells_moved(old, new) == pytest.approx(2.0)
    assert displacement(old, new)[3, 4].tolist() == pytest.approx([0.1, -0.05])
    few = old.x.copy()
    few[7, 3] += 0.3  # one node is no front
    assert cells_moved(old, em.Mesh(few, old.y)) < 0.01


def stay_valid(old: em.Mesh, new: em.Mesh) -> bool:
    return stays_valid(old.points, new.points, old.cells)


def test_cells_are_valid_on_their_way_where_they_are_at_all_times() -> None:
    rng, found = np.random.default_rng(7), list[bool]()
    old = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij"))
    for _ in range(200):
        new = np.tensordot(rng.normal(0.0, 1.5, (2, 2)), old, 1) + rng.normal(0.0, 0.1, (2, 2, 2))
        ways = (em.Mesh(*(old + t * (new - old))) for t in np.linspace(0.0, 1.0, 51))
        least = min(mesh.min_jacobian for mesh in ways)
        if abs(least) > 1e-2:
            found.append(least > 0.0)
            assert stay_valid(em.Mesh(*old), em.Mesh(*new)) == found[-1]
    assert 20 < sum(found) < len(found) - 20


def test_a_way_on_which_a_cell_folds_is_seen() -> None:
    old = smooth_mesh(9)
    assert stay_valid(old, smooth_mesh(9, depth=-0.08))
    turned = em.Mesh(-old.x, -old.y)  # a half turn: valid at both ends, and flat in the middle
    assert not turned.is_folded
    assert not stay_valid(old, turned)


def test_the_largest_jump_is_a_share_of_the_range() -> None:
    cells = em.Mesh(*np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij")).cells
    assert largest_jump(np.array([[0.0, 0.1], [0.5, 2.0]]), cells) == pytest.approx(1.9 / 2.0)
    assert largest_jump(np.ones((2, 2)), cells) == 0.0


def test_moves_on_blocks_count_in_cells_too() -> None:
    mesh = corner(4)
    far = mesh.moved(mesh.points + np.array([0.125, 0.0]))
    assert cells_moved(mesh, far) == pytest.approx(0.5)
    assert displacement(mesh, far).shape == (len(mesh.points), 2)
    assert stay_valid(mesh, far)
    assert largest_jump(mesh.x, mesh.cells) == pytest.approx(0.125)
    assert largest_jump(0 * mesh.x, mesh.cells) == 0.0


def test_cells_of_blocks_that_fold_on_the_way_are_found() -> None:
    mesh = disc(4)
    assert stay_valid(mesh, turned(mesh, 0.5))
    assert not stay_valid(mesh, turned(mesh, np.pi))  # both ends are valid, and half way all nodes meet


def test_a_changed_integral_is_told_with_its_size() -> None:
    old, new = disc(4), turned(disc(4), 0.1)
    field = {"rho": em.MeshValues(np.ones(len(old.points)), transfer="conservative")}
    assert list(about_integrals((old, new), field, {"rho": np.ones(len(new.points))})) == []
    (said,) = about_integrals((old, new), field, {"rho": np.full(len(new.points), 1.1)})
    assert said.startswith("The integral of rho changed by 1.0e-01 of itself")


def test_each_component_counts_and_splines_are_not_told() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    values = np.ones((5, 4, 2))
    other = values * [1.0, 2.0]
    for transfer, count in (("spline", 0), ("conservative", 1)):
        field = {"u": em.MeshValues(values, transfer=transfer)}
        assert len(list(about_integrals((mesh, mesh), field, {"u": other}))) == count
