"""The shape of a grid with a given number of points."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE
from equimesh.quality.measures import measure_errors
from equimesh.rounds.recovery import ErrorEstimate
from equimesh.rounds.shape import FixedPoints, ShapeSearch, best_grid, grid_of, on_grid, ratio_of, require_budget

SQUARE = em.Mesh.uniform(em.Grid(17))


def layer(power: float) -> em.Expression:
    return em.Expression(f"exp(-30*x) + {power}*exp(-30*y)")


@pytest.mark.parametrize(("u", "low", "high"), [("exp(-30*x)", 10.0, 20.0), ("exp(-30*y)", 1 / 20.0, 1 / 10.0)])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_one_direction_gets_nearly_all_lines_of_a_function_of_it(u: str, low: float, high: float, norm: str) -> None:
    found = best_grid(em.Expression(u), UNIT_SQUARE, 400, norm, SQUARE)
    assert low < ratio_of(found) < high
    assert 300 < found.points <= 400


def test_equal_directions_keep_the_grid() -> None:
    assert best_grid(layer(1.0), UNIT_SQUARE, 289, "l2", SQUARE) == SQUARE.grid


@pytest.mark.parametrize("points", [25, 289, 4000])
@pytest.mark.parametrize("ratio", [1e-6, 0.3, 1.0, 50.0, 1e6])
def test_a_grid_has_at_most_its_points(points: int, ratio: float) -> None:
    grid = grid_of(points, ratio)
    assert grid.points <= points
    assert min(grid.shape) >= 5


@pytest.mark.parametrize("points", [24, 0, -5, 100.5, True, "100", None])
def test_a_budget_without_a_grid_is_refused(points: object) -> None:
    with pytest.raises(em.InputError, match="at least 25 points") as refused:
        require_budget(points)
    assert refused.value.field == "points"


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_error_at_fixed_points_is_that_of_the_interpolant(norm: str) -> None:
    domain, u = em.Rectangle(x=(0.0, 2.0), y=(-1.0, 2.0)), em.Expression("sin(3*x + 2*y)")
    fine = em.Mesh.uniform(em.Grid(65))
    mesh = em.Mesh.uniform(em.Grid(17, 9))
    x, y = domain.map(mesh.x, mesh.y)
    measured = FixedPoints.of(u, domain, fine).error(mesh, u.evaluate(x, y)[0], norm)
    errors = measure_errors(em.Mesh(x, y), u, alone=True)
    assert measured == pytest.approx({"l2": errors.l2, "h1": errors.h1}[norm], rel=0.01)


def test_a_peak_inside_a_cell_is_an_error() -> None:
    peak = em.Expression("exp(-1000*((x - 0.52)**2 + (y - 0.52)**2))")
    seeing, blind = em.Mesh.uniform(em.Grid(129)), em.Mesh.uniform(em.Grid(5))
    fixed = FixedPoints.of(peak, UNIT_SQUARE, seeing)
    size = fixed.error(blind, np.zeros((5, 5)), "l2")
    assert size == pytest.approx(np.sqrt(np.pi / 2000.0), rel=1e-3)


def test_a_mesh_goes_to_another_grid() -> None:
    mesh = em.Mesh(*np.meshgrid(np.linspace(0, 1, 9) ** 2, np.linspace(0, 1, 9), indexing="ij"))
    found = on_grid(mesh, em.Grid(17, 5))
    assert found.grid == em.Grid(17, 5)
    assert found.x[:, 2] == pytest.approx(np.linspace(0, 1, 17) ** 2, abs=1e-3)
    assert on_grid(mesh, mesh.grid) is mesh


def test_a_loop_searches_once_the_solution_is_resolved_and_until_a_shape_is_kept() -> None:
    search = ShapeSearch(points=289)
    mesh = em.Mesh.uniform(search.first(UNIT_SQUARE))
    thin, even = (ErrorEstimate.of(mesh, f.evaluate(mesh.x, mesh.y)[0], UNIT_SQUARE) for f in THIN_AND_EVEN)
    assert search.grid(thin, "l2", 1) == mesh.grid
    assert not search.is_settled
    assert search.grid(even, "l2", 1) == mesh.grid
    assert search.is_settled


THIN_AND_EVEN = em.Expression("exp(-500*x)"), em.Expression("sin(3*x)*sin(3*y)")
