"""Solves on domains in blocks, and rounds: never worse than the initial mesh, from given meshes, by chosen weights."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.descent import Descent
from equimesh.quality.faces import measure_faces
from equimesh.rounds.round import adapt_round
from equimesh.solving import least_error as module
from equimesh.solving.least_error import NOT_BETTER
from equimesh.testing.geometries import disc, l_shape, naca0012_o, pitz_daily

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")


def problem(make=l_shape, nodes: int = 900, u: em.Field = FRONT, **settings) -> em.Problem[em.Blocks]:  # type: ignore[no-untyped-def]
    return em.Problem(monitor=em.LeastError(u=u, **settings), domain=make(nodes))


@pytest.mark.parametrize("make", [l_shape, disc, naca0012_o, pitz_daily])
def test_the_mesh_is_better_than_the_initial_one_and_not_folded(make) -> None:  # type: ignore[no-untyped-def]
    u = em.Expression("tanh(0.2*(x + 2*y - 20))") if make is pitz_daily else FRONT
    solution = em.solve(problem(make, u=u))
    assert solution.status is em.Status.COMPLETED
    assert not solution.mesh.is_folded
    assert solution.interpolation.gain_l2 > 1.5
    assert solution.message.startswith("The mesh is finished")


@pytest.mark.parametrize("settings", [{"norm": "h1"}, {"cells": "triangle"}], ids=str)
def test_the_norm_and_the_cells_are_those_of_the_monitor(settings: dict[str, str]) -> None:
    errors = em.solve(problem(**settings)).interpolation
    assert errors.estimated_gain(settings.get("norm", "l2")) > 1.5


def test_where_nothing_is_gained_the_mesh_is_the_initial_one() -> None:
    solution = em.solve(problem(u=em.Expression("2*x - y")))
    assert solution.mesh.distance(solution.initial) < 1e-14


def test_a_worse_mesh_is_replaced_by_the_initial_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "is_no_worse", lambda *_: False)
    solution = em.solve(problem())
    assert solution.mesh is solution.initial
    assert solution.note == module.NO_BETTER.format("initial")


def test_a_given_mesh_that_is_better_is_kept() -> None:
    first = em.solve(problem(smoothness=0.05))
    again = em.solve(problem(distortion=300.0, smoothness=300.0), initial=first.mesh)
    assert again.interpolation.l2 <= first.interpolation.l2 * (1 + 1e-12)


def test_weights_are_chosen_by_the_error() -> None:
    heard: list[Descent] = []
    asked = replace(problem(), monitor=em.Auto(u=FRONT, purpose="interpolation"))
    solution = em.solve(asked, observe=heard.append)  # type: ignore[arg-type]
    assert [one.chosen for one in solution.comparison] == [True, False]
    gains = [one.gain_l2 for one in solution.comparison]
    assert None not in gains
    assert gains[0] > gains[1]  # type: ignore[operator]
    fractions = [record.fraction for record in heard]
    assert None not in fractions
    assert fractions == sorted(fractions)  # type: ignore[type-var]
    assert fractions[-1] > 0.9  # type: ignore[operator]
    assert heard[0].phase.startswith("comparing monitors, 1 of 2: descending, step 0 of")


def test_weights_are_chosen_on_a_mesh_that_has_no_coarser_one() -> None:
    asked = replace(problem(nodes=60), monitor=em.Auto(u=FRONT))
    solution = em.solve(asked)
    assert {record["level"] for record in solution.descent} == {0}
    assert solution.interpolation.gain_l2 > 1.5


def test_starts_and_options_that_cannot_be_used_are_refused() -> None:
    asked = problem(nodes=300)
    own = asked.domain.mesh
    with pytest.raises(em.InputError, match="cells of the domain"):
        em.solve(asked, initial=l_shape(600).mesh)
    with pytest.raises(em.InputError, match="inverted"):
        em.solve(asked, initial=own.moved(own.points[::-1].copy()))
    with pytest.raises(em.InputError, match="mesh of a grid"):
        em.solve(asked, initial=em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5)))
    with pytest.raises(em.InputError, match="rectangles of a grid"):
        em.solve(asked, em.Schwarz(subdomains=(2, 2)))
    with pytest.raises(em.InputError, match="equidistribution"):
        em.solve(asked, mode=em.Mode.TIGHT)
    with pytest.raises(TypeError, match="did you mean 'threads'"):
        em.solve(asked, thread=1)  # type: ignore[call-overload]
    grid = em.Problem(monitor=em.LeastError(u=FRONT), grid=em.Grid(n_xi=5, n_eta=5))
    with pytest.raises(em.InputError, match="mesh of blocks"):
        em.solve(grid, initial=own)


def test_a_folded_mesh_is_never_a_success(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(solution: em.Solution[em.Blocks], *_: object) -> em.Solution[em.Blocks]:
        points = solution.initial.points[::-1].copy()
        return replace(solution, mesh=solution.initial.moved(points), status=em.Status.FOLDED)

    monkeypatch.setattr(module, "_or_given", folded)
    monkeypatch.setattr(module, "is_no_worse", lambda *_: True)
    asked = problem(nodes=300)
    with pytest.raises(em.SolveError) as caught:
        em.solve(asked, initial=asked.domain.mesh)
    assert isinstance(caught.value.solution.mesh, em.Mesh)
    assert np.isfinite(caught.value.solution.mesh.points).all()


@pytest.mark.parametrize("make", [l_shape, disc, naca0012_o])
def test_schwarz_between_blocks_gains_as_much_as_the_whole(make) -> None:  # type: ignore[no-untyped-def]
    asked = problem(make)
    whole, between = em.solve(asked), em.solve(asked, em.Schwarz())
    assert (whole.schwarz, between.schwarz) == (None, em.Schwarz())
    assert between.status is em.Status.COMPLETED
    assert not between.mesh.is_folded
    assert between.interpolation.gain_l2 > 0.9 * whole.interpolation.gain_l2
    threads = em.solve(asked, em.Schwarz(), threads=2)
    assert np.array_equal(threads.mesh.points, between.mesh.points)


def test_subdomains_go_with_chosen_weights_and_groups_with_names() -> None:
    domain = l_shape(900)
    groups = [["lower"], ["upper_left", "upper_right"]]
    solution = em.solve(em.Problem(monitor=em.Auto(u=FRONT), domain=domain), em.Schwarz(groups=groups))
    assert len(solution.comparison) == 2
    assert solution.interpolation.gain_l2 > 1.5


def test_settings_that_do_not_fit_the_problem_are_refused() -> None:
    domain = l_shape(300)
    nodal = em.NodalSolution(u=em.QuadField(mesh=domain.mesh, values=domain.mesh.x))
    with pytest.raises(em.InputError, match="leave the Schwarz settings out"):
        em.solve(em.Problem(monitor=nodal, domain=domain), em.Schwarz())
    with pytest.raises(em.InputError, match="no block 7"):
        em.solve(problem(), em.Schwarz(groups=[[0, 7]]))


def test_a_bound_below_the_angle_of_the_initial_mesh_keeps_that_angle() -> None:
    domain = naca0012_o(600)
    asked = em.Problem(monitor=em.LeastError(u=FRONT, orthogonality=30), domain=domain)
    solution = em.solve(asked)
    initial = measure_faces(domain.mesh).non_orthogonality
    assert 30.0 < solution.faces.non_orthogonality <= initial
    assert solution.note.startswith("The initial mesh has an angle of")


def test_a_singular_corner_is_seen_by_the_descent_as_by_a_finer_rule() -> None:
    solution = em.solve(problem(nodes=2500, u=em.Expression("(x**2 + y**2)**(1/3)"), smoothness=0.1))
    assert solution.descent[-1]["gain"] < 1.2 * solution.interpolation.gain_l2


def test_the_solution_has_the_monitor_that_was_chosen_and_its_cells() -> None:
    asked = em.Problem(monitor=em.Auto(u=FRONT, cells="triangle"), domain=l_shape(400))
    solution = em.solve(asked, threads=1)
    monitor = solution.problem.monitor
    assert isinstance(monitor, em.LeastError)
    chosen = next(one for one in solution.comparison if one.chosen)
    assert (monitor.distortion, monitor.smoothness) == (chosen.settings["distortion"], chosen.settings["smoothness"])
    assert monitor.cells == "triangle"


def test_a_uniform_start_is_the_initial_mesh_alone() -> None:
    solution = em.solve(problem(nodes=400), initial="uniform", threads=1)  # type: ignore[arg-type]
    assert {record["start"] for record in solution.descent} == {"initial"}
    both = em.solve(problem(nodes=400), threads=1)
    assert {record["start"] for record in both.descent} == {"initial", "rectilinear"}
    assert solution.newton_steps == sum(record["level"] == solution.descent[-1]["level"] for record in solution.descent)


@pytest.fixture(scope="module")
def solution() -> em.Solution[em.Blocks]:
    u = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
    return em.solve(em.Problem(monitor=em.LeastError(u=u), domain=l_shape(600)))


def test_errors_are_compared_with_the_initial_mesh(solution: em.Solution[em.Blocks]) -> None:
    comparison, errors = solution.against_uniform, solution.interpolation
    assert comparison.uniform.mesh is solution.initial
    for measured, l2 in ((comparison.adapted, errors.l2), (comparison.uniform, errors.l2_uniform)):
        assert measured.error is not None
        mesh = measured.mesh
        assert not mesh.is_grid
        assert np.sqrt((measured.error**2 * mesh.cell_areas()).sum()) == pytest.approx(l2, rel=1e-6)


def test_the_certificate_and_the_history_are_plain_numbers(solution: em.Solution[em.Blocks]) -> None:
    summary = json.loads(json.dumps(solution.certificate.summary()))
    assert summary["status"] == "completed"
    assert summary["interpolation_gain"]["l2"] > 1.5
    assert summary["min_jacobian"] == pytest.approx(solution.mesh.min_jacobian)
    assert summary["compared_with"] == "initial"
    assert solution.warnings == solution.certificate.warnings
    said = str(solution.certificate)
    assert "(error on the initial mesh over that on this one)" in said
    assert "(1 for a parallelogram of the mean area)" in said
    assert "uniform" not in said
    history = json.loads(json.dumps(solution.convergence()))
    assert history["descent"][-1]["points"] == solution.problem.points
    assert str(solution.problem.points) in repr(solution)


def test_the_contents_of_a_file_have_the_block_of_every_cell(solution: em.Solution[em.Blocks]) -> None:
    data = solution.data()
    assert data.u is not None
    assert data.u == pytest.approx(solution.problem.monitor.u.evaluate(solution.mesh.x, solution.mesh.y)[0])
    assert data.q_eq.shape == (len(solution.mesh.cells),)
    counts = np.bincount(data.subdomain)
    assert counts.tolist() == [cells.size for cells in solution.mesh.block_cells]


def test_a_coarse_mesh_of_a_steep_function_is_warned_about() -> None:
    u = em.Expression("tanh(300*(x + 0.31*y + 0.123))")
    coarse = em.solve(em.Problem(monitor=em.LeastError(u=u), domain=l_shape(100)))
    assert any("does not resolve it" in text or "inside a cell" in text for text in coarse.warnings)


GRID = em.Grid(n_xi=17, n_eta=17)
NODES = em.Mesh.uniform(GRID)
VALUES = np.tanh(10.0 * (NODES.x + NODES.y / 2 - 0.75))


def solved(values: np.ndarray, norm: str = "l2") -> em.Solution:
    monitor = em.NodalSolution(u=em.NodalField(mesh=NODES, values=values), norm=norm)
    return em.solve(em.Problem(monitor=monitor, grid=GRID))


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_solution_is_the_mesh_of_the_round(norm: str) -> None:
    solution, found = solved(VALUES, norm), adapt_round(NODES, VALUES, norm=norm)
    assert solution.status is em.Status.COMPLETED
    assert np.array_equal(solution.mesh.x, found.mesh.x)
    assert np.array_equal(solution.mesh.y, found.mesh.y)
    estimate = solution.certificate.estimate
    assert (estimate.l2, estimate.h1) == (found.estimate, found.estimate_h1)
    assert (estimate.unresolved, estimate.moved_cells) == (found.unresolved, found.moved_cells)
    first, *others = solution.comparison
    assert (first.settings["start"], first.chosen, any(one.chosen for one in others)) == (found.chosen, True, False)
    gains = [one.gain_l2 if norm == "l2" else one.gain_h1 for one in solution.comparison]
    assert gains == sorted(gains, reverse=True)
    assert solution.certificate.equation_residual is None
    assert solution.certificate.summary()["estimate"]["l2"] == found.estimate
    assert "of the given values, on their own mesh" in str(solution.certificate)


def test_values_of_a_linear_function_keep_their_mesh() -> None:
    solution = solved(2.0 * NODES.x - NODES.y)
    assert solution.mesh.distance(NODES) == 0.0
    assert solution.note == NOT_BETTER


def test_what_a_round_cannot_have() -> None:
    monitor = em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES))
    with pytest.raises(em.InputError, match="the grid has 9 x 9 points, the values are 17 x 17"):
        em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=9)))
    with pytest.raises(em.InputError, match="leave the Schwarz settings out"):
        em.solve(em.Problem(monitor=monitor, grid=GRID), em.Schwarz(subdomains=(2, 1)))


def test_on_blocks_the_solution_is_that_of_the_round() -> None:
    domain = l_shape(300)
    mesh = domain.mesh
    values = np.tanh(9 * (mesh.x + mesh.y - 1))
    problem = em.Problem(monitor=em.NodalSolution(u=em.QuadField(mesh=mesh, values=values)), domain=domain)
    solution = em.solve(problem, threads=1)
    found = em.adapt_round(mesh, values, domain)
    assert np.array_equal(solution.mesh.points, found.mesh.points)
    assert (solution.estimate.l2, solution.status) == (found.estimate, em.Status.COMPLETED)
    assert solution.certificate.comparison[0].chosen
    assert solution.interpolation.gain_l2 > 1.5
    assert solution.data().u.shape == mesh.node_shape


def test_values_on_a_mesh_of_another_kind_are_refused() -> None:
    domain, grid = l_shape(300), em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    of_grid = em.NodalSolution(u=em.NodalField(mesh=grid, values=grid.x))
    of_blocks = em.NodalSolution(u=em.QuadField(mesh=domain.mesh, values=domain.mesh.x))
    with pytest.raises(em.InputError, match="on a mesh of a grid and the domain is in blocks"):
        em.Problem(monitor=of_grid, domain=domain)
    with pytest.raises(em.InputError, match="on a mesh of a grid and the domain is in blocks"):
        em.solve(em.Problem(monitor=of_blocks, grid=grid.grid))
