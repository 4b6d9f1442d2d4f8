"""Warnings about a mesh: what its monitor, its grid, or rounding has not seen is said."""

from __future__ import annotations

import math
from dataclasses import replace

import error_estimates
import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.solving.certificate import _about_gains, safe_algebraic_error, safe_discretization_error

SPIKE = "exp(-1e5*((x - 0.503)**2 + (y - 0.507)**2))"
FRONT = "tanh(20*(x - y**2))"


def warnings(monitor: em.Monitor, n: int = 33) -> tuple[str, ...]:
    solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)))
    assert solution.status is em.Status.CONVERGED
    return solution.certificate.warnings


def arc(u: str, **settings: object) -> em.ArcLength:
    return em.ArcLength(u=em.Expression(u), **settings)  # type: ignore[arg-type]


def curvature(u: str) -> em.Curvature:
    return em.Curvature(u=em.Expression(u))


def test_a_mesh_that_is_worse_than_the_uniform_one_is_warned_about() -> None:
    """Arc length is no error monitor: it moves the points away from the extrema."""
    (warning,) = em.solve(problem("sine", 33)).certificate.warnings
    assert "worse than the uniform one" in warning
    assert "curvature" in warning
    assert em.solve(problem("tanh20", 33)).certificate.warnings == ()


@pytest.mark.parametrize(
    ("monitor", "n", "share"),
    [
        (curvature("where(x + y < 0.9, 0, 1)"), 33, 75),
        (curvature(SPIKE), 33, 95),
        (curvature("sin(64*pi*x)*sin(64*pi*y)"), 65, 50),
        (arc("sin(64*pi*x)*sin(64*pi*y)"), 65, 50),
    ],
)
def test_a_monitor_that_sees_nothing_of_u_is_told_of(monitor: em.Monitor, n: int, share: float) -> None:
    said = warnings(monitor, n)[-1]
    assert said.startswith("The mesh is uniform although u varies by ")
    assert float(said.partition("interpolant by ")[2].partition(" %")[0]) == pytest.approx(share, abs=10)
    assert "Add grid points, or take another monitor" in said


def test_a_monitor_whose_units_hide_u_is_told_of() -> None:
    (said,) = warnings(arc("1e-8*sin(3*x)*y", scaled=False))
    assert said.startswith("The mesh is uniform although u varies by 1e-08")
    assert said.endswith("Take a scaled arc length, so that the units of u do not matter.")


def test_structure_between_the_nodes_is_told_of_with_its_place() -> None:
    said = warnings(arc(SPIKE))[0]
    assert said.startswith("Between the nodes near (x, y) = (0.5")
    assert "99 % of its range: the mesh does not resolve it. Add grid points" in said


@pytest.mark.parametrize(
    "monitor",
    [
        arc("7"),
        arc("x + 2*y"),
        arc(FRONT),
        arc(FRONT, a=0.0),
        curvature("x**2 + y**2"),
        curvature("tanh(5*(x - y**2))"),
        em.Weight(rho=em.Expression("1"), u=em.Expression("sin(3*x)*y")),
    ],
    ids=str,
)
def test_nothing_is_said_where_all_is_well(monitor: em.Monitor) -> None:
    assert warnings(monitor) == ()


def test_a_layer_inside_a_cell_has_no_known_gain() -> None:
    solution = em.solve(em.Problem(monitor=arc("exp(-x/1e-6)"), grid=em.Grid(n_xi=33, n_eta=33)))
    certificate = solution.certificate
    assert certificate.resolved is False
    assert certificate.summary()["resolved"] is False
    assert certificate.summary()["interpolation_gain"]["h1"] is None
    assert "not known in H1" in str(certificate)
    assert certificate.warnings[0].startswith(
        "A layer, a jump or a kink of u lies inside a cell: the H1 gain is not known"
    )


def test_rounding_of_u_is_told_of_before_it_decides() -> None:
    (said,) = warnings(arc(f"1e8 + {FRONT}"))
    assert said.startswith("Rounding errors of u alone cause a residual of up to 2e-05")
    assert "subtract a constant" in said
    assert warnings(arc(f"1e4 + {FRONT}")) == ()


@pytest.mark.parametrize("monitor", [arc("sin(x)**2 + cos(x)**2"), curvature(f"1e13 + {FRONT}")], ids=str)
def test_a_function_that_counts_as_constant_because_of_rounding_is_told_of(monitor: em.Monitor) -> None:
    (said,) = warnings(monitor)
    assert said.startswith("u counts as constant or linear")


def test_a_mesh_of_least_error_is_told_of_rounding_and_of_what_it_does_not_see() -> None:
    def said(u: str, n: int) -> tuple[str, ...]:
        monitor = em.LeastError(u=em.Expression(u))
        return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n))).certificate.warnings

    assert said(f"1e15 + {FRONT}", 17)[0].startswith("u counts as constant or linear")
    assert said("sin(64*pi*x)*sin(64*pi*y)", 65)[0].startswith("The mesh is uniform although u varies")
    assert all("Finite-volume" in one for one in said(FRONT, 33))


def test_a_jump_between_neighbouring_samples_is_named_with_its_place() -> None:
    axis = np.linspace(0.0, 1.0, 65)
    x, _ = np.meshgrid(axis, axis, indexing="ij")
    jump = em.GridSamples(x=axis, y=axis, values=np.where(x > 0.5, 1.0, 0.0))
    smooth = em.GridSamples(x=axis, y=axis, values=np.tanh(20 * (x - 0.5)))
    found = {}
    for name, u in {"jump": jump, "smooth": smooth}.items():
        solution = em.solve(em.Problem(monitor=em.LeastError(u=u), grid=em.Grid(n_xi=17, n_eta=17)))
        found[name] = [text for text in solution.certificate.warnings if "neighbours" in text]
    assert not found["smooth"]
    assert "100 %" in found["jump"][0]
    assert "(0.5, 0)" in found["jump"][0]


def test_cells_as_thin_as_a_kink_are_named() -> None:
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("abs(x - 0.37)")), grid=em.Grid(n_xi=17, n_eta=17))
    warnings = em.solve(problem).certificate.warnings
    assert any("smallest Jacobian" in text for text in warnings)
    ordinary = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(20*x)")), grid=em.Grid(n_xi=17, n_eta=17))
    assert not any("smallest Jacobian" in text for text in em.solve(ordinary).certificate.warnings)


def test_a_mesh_for_u_that_loses_the_gradient_is_warned_about() -> None:
    errors = InterpolationErrors(l2=0.1, l2_uniform=0.2, h1=2.0, h1_uniform=1.0)
    (said,) = _about_gains(errors)
    assert "the gradient of u worse than the uniform one: its H1 error is 2 times as large" in said
    (on_blocks,) = _about_gains(errors, "initial")
    assert "worse than the initial one" in on_blocks
    assert [*_about_gains(replace(errors, h1=1.05))] == []
    assert [*_about_gains(replace(errors, resolved=(True, False)))] == []


def test_quadratic_elements_are_warned_of_a_mesh_for_bilinear_ones_where_they_lose() -> None:
    def said(u: str) -> list[str]:
        monitor = em.LeastError(u=em.Expression(u))
        solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=33, n_eta=33)))
        return [one for one in solution.certificate.warnings if "quadratic" in one]

    (warning,) = said("sin(2*pi*x)*sin(2*pi*y)")
    assert float(warning.partition("than on the uniform one, about ")[2].partition(" times for quadratic")[0]) > 4
    assert " times for cubic elements. If your elements are such" in warning
    assert said(FRONT) == []


def test_a_narrow_peak_on_blocks_needs_more_cells() -> None:
    peak = em.LeastError(u="exp(-20000*((x - 0.37)^2 + (y - 0.61)^2))")
    solution = em.solve(em.Problem(monitor=peak, domain=em.Blocks.rectangle(cells=(12, 12))))
    assert "the mesh does not resolve it. Give the blocks more cells." in " ".join(solution.certificate.warnings)


def test_quadratic_elements_on_blocks_are_compared_with_the_initial_mesh() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    domain = em.Blocks.of_mesh(nodes.points, nodes.cells, nodes.sides)
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("cos(3*x)*exp(y)")), domain=domain)
    warnings = em.solve(problem).certificate.warnings
    assert any("for quadratic elements" in one and "than on the initial one" in one for one in warnings)


SEED, COUNT = 7, 12  # of random problems


@pytest.mark.parametrize("safe", [safe_algebraic_error, safe_discretization_error])
def test_what_is_not_known_stays_unknown_and_what_is_exact_stays_exact(safe: object) -> None:
    assert [safe(value) for value in (None, math.nan, math.inf)] == [None, None, None]  # type: ignore[operator]
    assert safe(0.0) == 0.0  # type: ignore[operator]


def test_the_certificate_has_the_estimates_of_the_solve_and_a_margin() -> None:
    case = problem("paper", 33)
    *_, last = single_domain_steps(case, mode=em.Mode.DISCRETIZATION)
    certificate = em.solve(case).certificate
    for estimate, shown in (
        (last.algebraic_error, certificate.algebraic_error),
        (last.discretization_error, certificate.discretization_error),
    ):
        assert 1.2 * estimate < shown < 3 * estimate


@pytest.fixture(scope="module")
def found() -> list[error_estimates.Ratios]:
    return list(error_estimates.ratios(SEED, COUNT))


@pytest.mark.parametrize("name", ["algebraic", "discretization"])
def test_estimates_err_on_the_safe_side(found: list[error_estimates.Ratios], name: str) -> None:
    assert len(found) == COUNT
    ratios = np.array([getattr(one, name) for one in found])
    known = ratios[np.isfinite(ratios)]
    assert known.size >= COUNT - 1
    assert np.mean(known <= 1.0) >= 0.9
    assert np.median(known) > 0.1  # and not by a wide margin
