"""What a solver gets from a mesh: the errors of the Ritz projection."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh_data import joined
from equimesh.meshes.nested import tied_nodes
from equimesh.quality import ritz
from equimesh.quality.measures import measure_errors
from equimesh.quality.ritz import coarsened, ritz_errors, solver_gain
from solver.quality.handmade import triangle_errors

WAVE = em.Expression("tanh(5*(x - y**2)) + x*y")


def uniform(count: int) -> em.Mesh:
    return em.Mesh.uniform(em.Grid(n_xi=count, n_eta=count))


def wavy(count: int, size: float = 0.08) -> em.Mesh:
    """A mesh of oblique cells."""
    plain = uniform(count)
    bump = size * np.sin(np.pi * plain.x) * np.sin(2 * np.pi * plain.y)
    return em.Mesh(plain.x + bump, plain.y + bump)


def stretched(count: int) -> em.Mesh:
    """A mesh of straight lines at uneven distances."""
    plain = uniform(count)
    return em.Mesh(plain.x**1.5, plain.y + 0.1 * np.sin(2 * np.pi * plain.y))


LINEAR, QUADRATIC = "1000 + 3*x - 2*y", "1000 + 3*x*x - 2*x*y"
ELEMENTS = [(False, 1, LINEAR), (True, 1, LINEAR), (True, 2, QUADRATIC), *((False, p, LINEAR) for p in (2, 3, 4))]


@pytest.mark.parametrize(("triangles", "degree", "u"), ELEMENTS)
def test_the_projection_of_a_function_of_the_elements_is_this_function(triangles: bool, degree: int, u: str) -> None:
    found = ritz_errors(coarsened(wavy(9)), em.Expression(u), triangles=triangles, degree=degree)
    assert found.l2 < 1e-12 * 1000
    assert found.h1 < 1e-10 * 1000


def test_on_straight_lines_the_projection_of_u_of_x_alone_is_its_interpolant() -> None:
    u, mesh = em.Expression("exp(2*x)"), stretched(17)
    found, interpolation = ritz_errors(coarsened(mesh), u), measure_errors(mesh, u)
    assert found.l2 == pytest.approx(interpolation.l2, rel=1e-3)
    assert found.h1 == pytest.approx(interpolation.h1, rel=1e-3)


@pytest.mark.parametrize("triangles", [False, True])
def test_of_all_functions_of_the_elements_the_projection_has_the_smallest_error_of_the_gradient(
    triangles: bool,
) -> None:
    mesh = wavy(17)
    interpolation = (triangle_errors if triangles else measure_errors)(mesh, WAVE)
    found = ritz_errors(coarsened(mesh), WAVE, triangles=triangles)
    assert 0.5 * interpolation.h1 < found.h1 < interpolation.h1


@pytest.mark.parametrize(("triangles", "degree"), [(False, 1), (False, 2), (False, 3), (False, 4), (True, 2)])
def test_the_errors_fall_with_the_orders_of_the_elements(triangles: bool, degree: int) -> None:
    coarse, fine = (ritz_errors(coarsened(wavy(n)), WAVE, triangles=triangles, degree=degree) for n in (17, 33))
    assert math.log2(coarse.l2 / fine.l2) == pytest.approx(degree + 1, abs=0.15)
    assert math.log2(coarse.h1 / fine.h1) == pytest.approx(degree, abs=0.15)


@pytest.mark.parametrize("degree", [1, 3])
def test_a_closed_line_has_no_boundary_at_its_seam(degree: int) -> None:
    domain = em.AnnulusSector(closed=True)
    problem = em.Problem(monitor=em.ArcLength(u=WAVE), grid=em.Grid(n_xi=9, n_eta=17), domain=domain)
    mesh = problem.initial
    assert len(mesh.ties)
    one, other = (ritz_errors(q, WAVE, degree=degree) for q in (coarsened(mesh), joined(mesh)))
    assert (one.l2, one.h1) == pytest.approx((other.l2, other.h1), rel=1e-9)
    with_seam = ritz_errors(coarsened(em.Mesh(mesh.x, mesh.y)), WAVE, degree=degree)
    assert with_seam.l2 != pytest.approx(one.l2, rel=1e-6)


@pytest.mark.parametrize("degree", [1, 2])
def test_without_a_boundary_one_node_is_fixed(degree: int) -> None:
    u, mesh = em.Expression("sin(2*pi*x)*sin(2*pi*y)"), uniform(17)
    torus = em.Mesh(mesh.x, mesh.y, ties=tied_nodes(mesh.x.shape, (True, True)))
    found, plain = (ritz_errors(coarsened(one), u, degree=degree) for one in (torus, mesh))
    assert found.h1 == pytest.approx(plain.h1, rel=1e-3)


def test_of_a_large_grid_some_lines_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ritz, "MAX_GRID_POINTS", 17 * 17)
    mesh, plain = wavy(33), uniform(33)
    found = solver_gain(mesh, plain, WAVE)
    assert found.points == 17 * 17
    there = solver_gain(wavy(17), uniform(17), WAVE)
    assert there is not None
    assert dict(found) == pytest.approx(dict(there), rel=1e-9)
    uneven = coarsened(em.Mesh.uniform(em.Grid(n_xi=48, n_eta=7)))
    assert len(uneven.points) <= 17 * 17
    assert uneven.points.max(axis=0).tolist() == [1.0, 1.0]


def test_large_blocks_are_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = coarsened(wavy(9)), coarsened(uniform(9))
    assert solver_gain(*blocks, WAVE) is not None
    monkeypatch.setattr(ritz, "MAX_BLOCK_POINTS", 80)
    assert solver_gain(*blocks, WAVE) is None


def test_what_is_not_known_is_nan() -> None:
    folded = em.Mesh(wavy(9).x, wavy(9).x)
    assert math.isnan(ritz_errors(coarsened(folded), WAVE).l2)
    with np.errstate(all="ignore"):
        assert math.isnan(ritz_errors(coarsened(uniform(9)), em.Expression("sqrt(x - 0.5)")).l2)
    found = solver_gain(folded, uniform(9), WAVE)
    assert math.isnan(found.l2)
    assert math.isnan(found.h1)


def solved(monitor: em.Monitor, count: int = 17) -> em.Solution:
    return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=count, n_eta=count)), threads=1, check=False)


def test_the_certificate_of_least_error_and_of_auto_has_it_and_that_of_a_metric_only_on_request() -> None:
    u = em.Expression("tanh(20*(x+y/2-0.75))")
    for monitor in (em.Auto(u=u), em.LeastError(u=u, rectilinear=True)):
        solution = solved(monitor)
        found = solution.certificate.solver_gain
        assert found is not None
        assert found == solution.solver_gain
        assert solution.certificate.headline.startswith("A solver's error is ")
    by_metric = solved(em.ArcLength(u=u))
    assert by_metric.certificate.solver_gain is None
    assert by_metric.solver_gain.l2 > 1.0
    assert solved(em.Weight(rho=em.Expression("1 + x"))).solver_gain is None


def test_a_layer_inside_a_cell_leaves_it_unknown() -> None:
    found = solved(em.LeastError(u=em.Expression("tanh(1e7*(x-0.5123))"), rectilinear=True), 9)
    assert not found.interpolation.resolved[1]
    assert math.isnan(found.solver_gain.h1)


def test_on_triangles_it_is_that_of_linear_elements() -> None:
    u = em.Expression("tanh(20*(x+y/2-0.75))")
    solution = solved(em.LeastError(u=u, cells="triangle"))
    linear = solver_gain(solution.mesh, solution.initial, u, triangles=True)
    bilinear = solver_gain(solution.mesh, solution.initial, u)
    assert solution.solver_gain == linear
    assert linear.l2 != pytest.approx(bilinear.l2, rel=0.1)


def test_a_matrix_is_solved_alike_as_a_band_and_by_its_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = coarsened(wavy(9))
    band = ritz_errors(mesh, WAVE)
    monkeypatch.setattr(ritz.scipy.linalg, "solveh_banded", refused)
    monkeypatch.setattr(ritz, "MAX_BAND_WORK", 7**2 * 9**2 - 1)  # a row has 7 unknowns, and a cell meets the next row
    assert ritz_errors(mesh, WAVE).l2 == pytest.approx(band.l2, rel=1e-12)
    monkeypatch.setattr(ritz, "MAX_BAND_WORK", 7**2 * 9**2)
    assert ritz_errors(mesh, WAVE).l2 == pytest.approx(band.l2, rel=1e-12)  # not definite: by its entries, too
    assert CALLS == [9]


CALLS: list[int] = []


def refused(band: np.ndarray, *_: object, **__: object) -> np.ndarray:
    CALLS.append(len(band))
    raise np.linalg.LinAlgError
