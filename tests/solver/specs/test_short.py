"""The short call from a function to its mesh: forms of u and of the grid, and what is refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.specs.short import field_of

FRONT = "tanh(10*(x + y/2 - 0.75))"
AXIS = np.linspace(0.0, 1.0, 33)
VALUES = np.tanh(10 * (AXIS[:, None] + AXIS / 2 - 0.75))
RECTANGLE = em.Rectangle(x=(0.0, 2.0), y=(0.0, 1.0))


def test_it_is_the_solution_of_the_problem() -> None:
    short = em.mesh(FRONT, 9)
    long = em.solve(em.Problem(monitor=em.Auto(u=em.Expression(FRONT)), grid=em.Grid(n_xi=9, n_eta=9)))
    np.testing.assert_array_equal(short.mesh.points, long.mesh.points)
    assert short.gain == long.certificate.solver_gain["l2"] > 1.5


@pytest.mark.parametrize("grid", [(9, 7), em.Grid(n_xi=9, n_eta=7), (np.int64(9), 7)])
def test_settings_are_those_of_the_monitor(grid: Any) -> None:
    found = em.mesh("k*x*y", grid, RECTANGLE, monitor="arc_length", b=0.5, parameters={"k": 3.0})
    monitor = found.problem.monitor
    assert isinstance(monitor, em.ArcLength)
    assert (monitor.b, found.mesh.x.shape, found.mesh.x.max()) == (0.5, (9, 7), 2.0)
    np.testing.assert_array_equal(found.u, 3.0 * found.mesh.x * found.mesh.y)


@pytest.mark.parametrize(
    "u",
    [
        em.Expression(FRONT),
        lambda x, y: np.tanh(10 * (x + y / 2 - 0.75)),
        VALUES,
        VALUES.tolist(),
        (AXIS, AXIS, VALUES),
        {"x": AXIS, "y": AXIS, "values": VALUES},
        (np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=2).reshape(-1, 2), VALUES.ravel()),
        (*np.meshgrid(AXIS, AXIS, indexing="ij"), VALUES),
    ],
)
def test_forms_of_a_function(u: Any) -> None:
    x, y = np.array([0.3, 0.71]), np.array([0.9, 0.05])
    found = field_of(u).evaluate(x, y)[0]
    np.testing.assert_allclose(found, np.tanh(10 * (x + y / 2 - 0.75)), atol=2e-2)


def test_a_callable_is_sampled_on_the_domain() -> None:
    np.testing.assert_allclose(field_of(lambda x, _: x, RECTANGLE).evaluate(np.array([1.7]), np.array([0.5]))[0], 1.7)


def test_values_of_blocks() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    blocks = em.Blocks.of_mesh(uniform.points, uniform.cells, uniform.sides)
    nodes = blocks.mesh.points
    found = em.mesh({"nodes": nodes, "values": nodes[:, 0] ** 2}, domain=blocks, monitor="least_error")
    assert found.status.succeeded
    with pytest.raises(em.InputError, match="leave the grid out") as caught:
        em.mesh("x", 9, blocks)
    assert caught.value.field == "grid"


@pytest.mark.parametrize(
    ("given", "field", "sentence"),
    [
        ({"u": 5}, "u", "u is an expression, an array"),
        ({"u": np.ones(3)}, "u", "an array u has two dimensions"),
        ({"u": lambda x, y: float(x) + y}, "u", r"numpy\.vectorize"),
        ({"u": np.full((3, 3), np.nan)}, "u", "samples must be finite"),
        ({"u": np.ones((3, 3)), "t": 2.0}, "parameters", "belong to a formula"),
        ({"u": "x", "grid": "9"}, "grid", "grid = '9': give a number of points a side"),
        ({"u": "x", "grid": (9.0, 9)}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": ("a", "b")}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": (9, 9, 9)}, "grid", "give a number of points a side"),
        ({"u": "x", "grid": em.Target(error=0.1)}, "grid", r"solve_to\(Target\(\.\.\.\), monitor=Auto\(u\)\)"),
        ({"u": "1/(x - 0.5)"}, "expression", r"not finite at \(x, y\) = \(0\.5, 0\), because of 1/\(x - 0\.5\)"),
        ({"u": "x", "grid": 1}, "grid.n_xi", "at least"),
        ({"u": "x", "monitor": "weight"}, "monitor", "choose one of auto, least_error, arc_length, curvature$"),
        ({"u": "x", "monitor": "least-error"}, "monitor", "perhaps least_error is meant$"),
        ({"u": "x", "monitor": em.Auto(u="x")}, "monitor", r"solve\(Problem\(monitor=\.\.\.\)\) takes"),
        ({"u": "x", "degree": "2"}, "degree", "degree = '2': give"),
        ({"u": em.Expression}, "u", r"u\(x, y\) must take arrays"),
        ({"u": "x", "parameters": 3}, "parameters", "by their names"),
        ({"u": "x", "distrotion": 2.0, "monitor": "least_error"}, "distrotion", "perhaps distortion is meant"),
        ({"u": "x", "mode": "tight"}, "mode", "has no setting 'mode'; it has norm, "),
        ({"u": "x", "monitor": "arc_length", "degree": 2}, "degree", "; auto and least_error have it; it has a, b,"),
    ],
)
def test_refusals_say_what_to_do(given: dict[str, Any], field: str, sentence: str) -> None:
    with pytest.raises(em.InputError, match=sentence) as caught:
        em.mesh(**given)
    assert caught.value.field == field


def test_dir_shows_what_people_need() -> None:
    assert dir(em) == sorted(em.__all__)
    assert "mesh" in dir(em)


def test_whole_numbers_may_be_those_of_numpy() -> None:
    two = np.int64(2)
    solution = em.mesh("tanh(9*(x - y))", (np.int64(9), 8), degree=two, orthogonality=np.int64(60))
    assert json.loads(json.dumps(solution.certificate.summary()))["degree"] == 2
    em.Schwarz(subdomains=(two, 1), overlap=two, max_iterations=two)
    em.Target(error=two, max_points=np.int64(1000))
    with pytest.raises(em.InputError, match="whole number"):
        em.mesh("x*y", 9, degree=np.True_)


def test_first_values_are_taken_by_position() -> None:
    u = em.Expression("x*y")
    assert em.Grid(9) == em.Grid(9, 9) == em.Grid(n_xi=9, n_eta=9)
    assert em.Rectangle((0.0, 2.0), (0.0, 1.0)) == RECTANGLE
    for kind in (em.Auto, em.LeastError, em.ArcLength, em.Curvature):
        assert em.Problem(kind(u), em.Grid(9)).monitor.u is u
        with pytest.raises(TypeError, match="positional"):
            kind(u, "h1")  # type: ignore[operator]
