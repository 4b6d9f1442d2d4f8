"""One round of adapting on domains in blocks."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.kernels import Rule
from equimesh.rounds.candidates import PARTS
from equimesh.rounds.estimate import ErrorEstimate
from equimesh.rounds.next_mesh import KEPT, moved_cells
from equimesh.rounds.norms import measured
from equimesh.rounds.recovery import Recovery
from equimesh.rounds.round import WHOLE, next_mesh
from equimesh.testing.geometries import disc, l_shape

DOMAIN = l_shape(500)
FRONT = em.Expression("tanh(15*(x + y - 1))")


def values_on(mesh: em.Mesh) -> np.ndarray:
    """The front at the nodes."""
    return FRONT.evaluate(mesh.x, mesh.y)[0]


def test_two_rounds_lower_the_error_and_begin_from_both_meshes() -> None:
    mesh = DOMAIN.mesh.moved(np.nextafter(DOMAIN.mesh.points, 2.0))  # as a service answers with it
    errors = [measured(FRONT, DOMAIN, mesh, Rule(norm="l2", points=3))]
    names = []
    for _ in range(2):
        found = em.adapt_round(mesh, values_on(mesh), DOMAIN)
        mesh = found.mesh
        names.append({*found.candidates})
        errors.append(measured(FRONT, DOMAIN, mesh, Rule(norm="l2", points=3)))
        assert not mesh.is_folded
        assert np.array_equal(mesh.cells, DOMAIN.mesh.cells)
        assert found.candidates[found.chosen] == min(found.candidates.values())
    assert names == [{WHOLE}, {WHOLE, PARTS}]
    assert errors[0] / errors[1] > 1.8
    assert errors[0] / errors[2] > 2.7


def test_equal_arguments_give_equal_meshes_on_any_number_of_threads() -> None:
    mesh = DOMAIN.mesh
    one, other = (em.adapt_round(mesh, values_on(mesh), DOMAIN, "h1", threads) for threads in (1, 2))
    assert np.array_equal(one.mesh.points, other.mesh.points)
    assert one.gain == other.gain > 1.0


def test_nodes_of_a_curve_stay_on_it() -> None:
    domain = disc(300)
    found = em.adapt_round(domain.mesh, np.tanh(9 * domain.mesh.x), domain)
    on = domain.node_curve >= 0
    assert np.abs(np.hypot(found.mesh.x, found.mesh.y)[on] - 1.0).max() < 1e-12
    assert found.moved_cells > 0.3


def test_a_linear_function_keeps_its_mesh() -> None:
    mesh = DOMAIN.mesh
    found = em.adapt_round(mesh, 1 + mesh.x, DOMAIN)
    assert (found.mesh is mesh, found.chosen, found.estimate, found.moved_cells) == (True, KEPT, 0.0, 0.0)


def test_a_thin_front_is_not_resolved_and_a_smooth_function_is() -> None:
    mesh = DOMAIN.mesh
    thin = ErrorEstimate.of(mesh, np.tanh(200 * (mesh.x + mesh.y - 1)), DOMAIN)
    smooth = ErrorEstimate.of(mesh, np.sin(mesh.x + mesh.y), DOMAIN)
    assert thin.unresolved > 0.15 > 0.05 > smooth.unresolved
    assert not thin.is_exact
    assert [next_mesh(one, "h1").norm for one in (thin, smooth)] == ["l2", "h1"]


def test_a_mesh_and_a_domain_of_two_kinds_are_refused() -> None:
    grid = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    with pytest.raises(em.InputError, match="one of a grid and the domain one of blocks"):
        em.adapt_round(grid, grid.x, DOMAIN)
    with pytest.raises(em.InputError, match="one of a grid and the domain one of blocks"):
        em.adapt_round(DOMAIN.mesh, DOMAIN.mesh.x)


TWO_SQUARES = l_shape(300)


def test_the_estimate_is_near_the_error_of_smooth_values() -> None:
    mesh, u = TWO_SQUARES.mesh, em.Expression("sin(4*x + y)")
    known = Recovery.of(mesh, u.evaluate(mesh.x, mesh.y)[0], TWO_SQUARES)
    for norm in ("l2", "h1"):
        wanted = measured(u, TWO_SQUARES, mesh, Rule(norm=norm, points=3), of_solver=norm == "l2")
        assert known.estimate(norm) == pytest.approx(wanted, rel=0.15)


def test_a_linear_function_has_no_error_but_rounding() -> None:
    mesh = TWO_SQUARES.mesh
    known = Recovery.of(mesh, 1 + 2 * mesh.x - mesh.y, TWO_SQUARES)
    assert known.estimate("l2") < known.rounding
    assert known.gradient_norm() == pytest.approx(np.sqrt(5 * TWO_SQUARES.area))


def test_the_measured_error_is_that_of_the_quality() -> None:
    monitor = em.LeastError(u=em.Expression("tanh(9*(x - y))"))
    solution = em.solve(em.Problem(monitor=monitor, domain=TWO_SQUARES), threads=1)
    for mesh, wanted in (
        (solution.mesh, solution.interpolation.l2),
        (TWO_SQUARES.mesh, solution.interpolation.l2_uniform),
    ):
        assert measured(monitor.u, TWO_SQUARES, mesh, Rule(norm="l2", points=4)) == pytest.approx(wanted, rel=1e-3)


def test_moves_count_in_lengths_of_the_mean_cell() -> None:
    mesh = TWO_SQUARES.mesh
    length = np.sqrt(TWO_SQUARES.area / len(mesh.cells))
    assert moved_cells(mesh, mesh.moved(mesh.points + np.array([0.0, 0.5 * length]))) == pytest.approx(0.5)


def test_values_on_another_mesh_are_refused() -> None:
    other = disc(300).mesh
    with pytest.raises(em.InputError, match="other cells than the domain"):
        Recovery.of(other, other.x, TWO_SQUARES)
    finer = TWO_SQUARES.refined(2).mesh
    monitor = em.NodalSolution(u=em.QuadField(mesh=finer, values=finer.x))
    with pytest.raises(em.InputError, match="other cells than the domain"):
        em.solve(em.Problem(monitor=monitor, domain=TWO_SQUARES))


def test_a_round_chooses_the_counts_of_at_most_so_many_points() -> None:
    mesh = DOMAIN.mesh
    values = np.tanh(5.0 * (mesh.y - 0.3))
    found = em.adapt_round(mesh, values, DOMAIN, points=400)
    _, left, _ = (block.shape for block in found.mesh.blocks)
    assert left[1] > 4 * left[0]  # the front is level
    assert 300 < found.mesh.x.size <= 400
    assert not found.mesh.is_folded
    sharp = em.adapt_round(mesh, np.tanh(60.0 * (mesh.y - 0.3)), DOMAIN, points=200)
    assert sharp.unresolved > 0.2
    assert 150 < sharp.mesh.x.size <= 200  # in proportion, until the values resolve u
    with pytest.raises(em.InputError, match="leave points out"):
        em.adapt_round(mesh, values, DOMAIN, points=400, adjoint=values)


def test_a_mesh_of_more_points_than_allowed_is_not_kept_where_its_values_are_exact() -> None:
    mesh = em.Mesh.uniform(em.Grid(20))
    assert em.adapt_round(mesh, mesh.x, points=50).mesh.x.size <= 50
    blocks = l_shape(300)
    fine = blocks.refined(2).mesh
    found = em.adapt_round(fine, fine.x, blocks.with_counts_of(fine), points=300).mesh
    assert found.x.size <= 300
    assert not found.is_folded
