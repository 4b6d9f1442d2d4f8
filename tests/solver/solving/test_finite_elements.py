"""The choice for finite elements: by what a solver gets, the least oblique of the best, never worse than uniform."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.quality.ritz import RitzErrors, solver_gain
from equimesh.solving import auto, solve
from equimesh.solving import solution as solution_module
from equimesh.solving.solve import METRICS_ONLY

LAYER = "(1 - exp(40*(x - 1)))*sin(pi*y)"
FRONT_10 = em.Expression("tanh(10*(x + y/2 - 0.75))")
PURPOSES: tuple[Any, Any] = ("finite_element", "interpolation")


def chosen(text: str, n: int = 17, schwarz: em.Schwarz | None = None, **more: Any) -> em.Solution:
    domain, purpose = more.pop("domain", em.Rectangle()), more.pop("purpose", "finite_element")
    monitor = em.Auto(u=em.Expression(text), purpose=purpose, **more)
    return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n), domain=domain), schwarz, threads=1)


def test_a_solver_gets_more_on_less_oblique_cells() -> None:
    plain, better = (chosen(LAYER, purpose=purpose) for purpose in ("interpolation", "finite_element"))
    assert better.solver_gain.l2 > 2.0 * plain.solver_gain.l2
    assert better.faces.non_orthogonality < auto.MODERATE_ANGLE < plain.faces.non_orthogonality
    assert better.certificate.solver_gain == better.solver_gain


@pytest.mark.parametrize(
    ("found", "taken"),
    [
        ([(3.0, 70.0), (2.0, 50.0), (1.5, 0.0)], 1),  # moderate angles at a moderate price
        ([(3.0, 70.0), (1.7, 50.0), (2.6, 65.0)], 2),  # they gain too little: the least oblique of the best
        ([(3.0, 59.0), (2.9, 50.0), (2.0, 0.0)], 1),  # the least oblique of the best moderate ones
        ([(3.0, 70.0), (2.6, 65.0), (2.5, 61.0)], 1),
    ],
)
def test_moderate_angles_are_taken_where_they_cost_little(found: list[tuple[float, float]], taken: int) -> None:
    monitor = em.Auto(u=em.Expression("x"), purpose="finite_element")
    errors: Any = "measured"
    candidates = [
        auto.CoarseCandidate(
            kind="least_error", settings={}, monitor=monitor, errors=errors, solver=solver, angle=angle
        )
        for solver, angle in found
    ]
    tried = sorted(candidates, key=lambda one: -one.solver)
    assert auto._straightest(tried, monitor, auto.MODERATE_ANGLE) is candidates[taken]


def test_the_candidates_are_told_with_what_a_solver_gets() -> None:
    solution = chosen("tanh(20*(x + y/2 - 0.75))")
    gains = [one.gain_solver for one in solution.comparison]
    assert gains == sorted(gains, reverse=True)
    (taken,) = [one for one in solution.comparison if one.chosen]
    assert solution.solver_gain.l2 == pytest.approx(taken.gain_solver, rel=1e-6)  # compared on the grid itself
    assert "for a solver" in str(solution.certificate)
    monitor = solution.problem.monitor
    assert isinstance(monitor, em.LeastError)
    again = em.LeastError(u=monitor.u, **taken.settings)
    mesh = em.solve(em.Problem(monitor=again, grid=solution.problem.grid), threads=1, check=False).mesh
    assert mesh.distance(solution.mesh) == 0.0


def test_the_chosen_mesh_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    measured, measure = list[Mesh](), solution_module.measure_errors

    def counted(mesh: Mesh, u: em.Field, **more: Any) -> Any:
        measured.append(mesh)
        return measure(mesh, u, **more)

    for module in (auto, solution_module):
        monkeypatch.setattr(module, "measure_errors", counted)
    found = chosen(LAYER)
    known = found.interpolation
    assert found.comparison
    assert sum(np.array_equal(mesh.points, found.mesh.points) for mesh in measured) == 1
    again = found._measured.errors()
    assert known is not None
    assert again is not None
    assert (known.l2, known.h1, known.resolved, known.largest) == (again.l2, again.h1, again.resolved, again.largest)
    assert (known.gain_l2, known.gain_h1) == pytest.approx((again.gain_l2, again.gain_h1), rel=1e-12)


def test_straight_lines_that_cannot_be_chosen_are_left_out() -> None:
    oblique, upright = (chosen(text).comparison for text in ("tanh(20*(x + y/2 - 0.75))", "tanh(20*(x - 0.4))"))
    assert not any("rectilinear" in one.settings for one in oblique)
    assert any("rectilinear" in one.settings for one in upright)


def test_where_no_candidate_is_better_for_a_solver_the_mesh_is_uniform(monkeypatch: pytest.MonkeyPatch) -> None:
    text, gain = "sin(pi*x)*sin(pi*y)", RitzErrors.gain
    kept = chosen(text, 9)
    monkeypatch.setattr(RitzErrors, "gain", lambda *given: 0.5 * gain(*given))
    solution = chosen(text, 9)
    assert np.array_equal(solution.mesh.x, Mesh.uniform(solution.problem.grid).x)
    assert solve.NO_BETTER_FOR_SOLVERS.format("uniform") in solution.warnings
    assert not np.array_equal(kept.mesh.x, solution.mesh.x)


def test_with_subdomains_the_candidates_are_metrics() -> None:
    solution = chosen("tanh(8*(x - y*y))", schwarz=em.Schwarz(subdomains=(2, 1)))
    assert {one.kind for one in solution.comparison} == {"curvature", "arc_length"}
    assert METRICS_ONLY in solution.warnings
    assert solution.solver_gain.l2 >= 1.0


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_closed_domain_is_compared_as_it_is(norm: Any) -> None:
    solution = chosen("tanh(5*(x - y))", 9, domain=em.AnnulusSector(closed=True), norm=norm)
    (taken,) = [one for one in solution.comparison if one.chosen]
    found = solver_gain(solution.mesh, solution.initial, solution.problem.monitor.u)  # type: ignore[arg-type]
    assert taken.gain_solver == pytest.approx(found[norm], rel=1e-6)
    assert found[norm] > 1.0


def test_triangles_are_compared_by_linear_elements() -> None:
    solution = chosen("tanh(20*(x + y/2 - 0.75))", 9, cells="triangle")
    (taken,) = [one for one in solution.comparison if one.chosen]
    assert taken.gain_solver == pytest.approx(solution.solver_gain.l2, rel=1e-6)


def test_blocks_are_chosen_by_what_a_solver_gets() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    blocks = em.Blocks.of_mesh(mesh.points, mesh.cells, mesh.sides)
    u = em.Expression("tanh(20*(x + y/2 - 0.75))")
    found, plain = (
        em.solve(em.Problem(monitor=em.Auto(u=u, purpose=purpose), domain=blocks), threads=1) for purpose in PURPOSES
    )
    taken = next(one for one in found.comparison if one.chosen)
    assert len(found.comparison) == 2  # straight lines are those of a grid
    assert taken.settings["purpose"] == "finite_element"
    assert found.solver_gain.l2 == pytest.approx(taken.gain_solver, rel=1e-6)
    assert found.solver_gain.l2 > 1.2 * plain.solver_gain.l2
    assert all(math.isnan(one.gain_solver) for one in plain.comparison)


@pytest.mark.parametrize(("cells", "degree"), [("quad", 2), ("quad", 3), ("triangle", 2)])
def test_elements_of_higher_degree_are_chosen_by_their_solver_with_moderate_angles(cells: Any, degree: int) -> None:
    solution = chosen("tanh(10*(x + y/2 - 0.75))", cells=cells, degree=degree)
    taken = next(one for one in solution.comparison if one.chosen)
    assert {one.settings["degree"] for one in solution.comparison} == {degree}
    found = solver_gain(solution.mesh, solution.initial, FRONT_10, triangles=cells == "triangle", degree=degree)
    assert found.l2 == pytest.approx(taken.gain_solver, rel=1e-6)
    assert solution.solver_gain == found
    assert found.l2 > 1.5
    assert solution.faces.non_orthogonality < auto.MODERATE_ANGLE
