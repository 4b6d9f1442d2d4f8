"""Functionals of a solution, and what a solver returns for them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_matrix

import equimesh as em
from equimesh_coupling.adaptation import GoalRecord
from equimesh_coupling.errors import BadValues
from equimesh_coupling.goals import GoalValues, goal_values
from equimesh_schema import ErrorProducts
from equimesh_schema.certificate import Estimate

X, Y = np.meshgrid(np.linspace(0.0, 1.0, 9) ** 1.5, np.linspace(0.0, 1.0, 7), indexing="ij")
MESH = em.Mesh(X + 0.05 * np.sin(math.pi * X) * np.sin(math.pi * Y), Y)
U = 1.0 + 2.0 * MESH.x - 3.0 * MESH.y
POINT = em.Goal.point(0.3, 0.4)


def is_in_disc(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.hypot(x - 0.5, y - 0.5) < 0.3


def is_in_gap(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x > 2.0) & (y > 2.0)


@pytest.mark.parametrize(
    ("goal", "value", "tolerance"),
    [
        (POINT, 0.4, 1e-12),
        (em.Goal.point(0.0, 1.0), -2.0, 1e-12),
        (em.Goal.integral(), 0.5, 1e-12),
        (em.Goal.integral(is_in_disc), 0.5 * math.pi * 0.09, 5e-6),
        (em.Goal.over_side("left"), -0.5, 1e-12),
        (em.Goal.over_side("top"), -1.0, 1e-12),
        (em.Goal(lambda mesh: np.ones(mesh.node_shape) / 63.0), float(U.mean()), 1e-12),
    ],
    ids=["point", "corner", "integral", "disc", "left", "top", "weights of its own"],
)
def test_functionals_of_a_linear_function(goal: em.Goal, value: float, tolerance: float) -> None:
    assert goal.on(MESH) @ U.ravel() == pytest.approx(value, abs=tolerance)


def laplacian() -> np.ndarray:
    """A matrix of rows that sum to zero, of a chain of nodes; not symmetric."""
    n = MESH.x.size
    return 3.0 * np.eye(n) - 2.0 * np.eye(n, k=1) - np.eye(n, k=-1)


SIDE = np.arange(7)
"""The nodes of the left side."""


def test_the_adjoint_follows_from_the_matrix() -> None:
    found = goal_values(em.WithAdjoint(U, matrix=csr_matrix(laplacian()), fixed=SIDE), MESH, POINT)
    z = found.z.ravel()
    assert not z[SIDE].any()
    assert (laplacian().T @ z)[7:] == pytest.approx(POINT.on(MESH)[7:], abs=1e-12)
    assert (found.value, found.error) == (pytest.approx(0.4), None)


def test_a_flux_is_what_is_left_of_the_equations_on_its_side() -> None:
    goal, load = em.Goal.flux("left"), np.linspace(1.0, 2.0, MESH.x.size)
    returned = em.WithAdjoint(U, matrix=laplacian(), fixed=SIDE, load=load)
    found = goal_values(returned, MESH, goal)
    assert found.value == pytest.approx(float((laplacian() @ U.ravel() - load)[SIDE].sum()))
    assert (found.z.ravel()[SIDE] == -1.0).all()
    assert (laplacian().T @ found.z.ravel())[7:] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("returned", "goal", "words"),
    [
        (U, POINT, "return WithAdjoint"),
        (em.WithAdjoint(U), POINT, "return WithAdjoint"),
        (em.WithAdjoint(U, U[:-1]), POINT, "the adjoint has the shape"),
        (em.WithAdjoint(U[:-1], U), POINT, "the solution has the shape"),
        (em.WithAdjoint(U, 0.0 * U), POINT, "the functional is constant"),
        (em.WithAdjoint(U, U), em.Goal(lambda mesh: 0.0 * mesh.x), "the functional is constant"),
        (em.WithAdjoint(U, matrix=np.eye(63), fixed=range(63)), POINT, "the functional is constant"),
        (em.WithAdjoint(U, matrix=np.eye(62)), POINT, "the matrix has the shape"),
        (em.WithAdjoint(U, matrix=1j * np.eye(63)), POINT, "the matrix has complex"),
        (em.WithAdjoint(U, matrix="A"), POINT, "the matrix is no sparse one"),
        (em.WithAdjoint(U, matrix=np.zeros((63, 63))), POINT, "singular"),
        (em.WithAdjoint(U, matrix=np.eye(63), fixed=[70]), POINT, "fixed names no nodes"),
        (em.WithAdjoint(U, U), em.Goal.flux("left"), "return matrix and load"),
        (em.WithAdjoint(U, U, matrix=np.eye(63), load=[1.0]), em.Goal.flux("left"), "the load has 1 values"),
        (em.WithAdjoint(U, matrix=np.eye(63)), em.Goal.flux("left"), "values are not given on all of the side"),
        (em.WithAdjoint(U, U, value=math.nan), POINT, "return finite numbers"),
        (em.WithAdjoint(U, U), em.Goal(lambda mesh: mesh.x[0]), "the functional has 7 weights"),
        (em.WithAdjoint(U, U), em.Goal.point(2.0, 0.5), "outside of the mesh"),
        (em.WithAdjoint(U, U), em.Goal.over_side("north"), "no side 'north'"),
        (em.WithAdjoint(U, U), em.Goal.integral(is_in_gap), "no cell of the mesh has a part"),
        (em.WithAdjoint(U, U), em.Goal.integral(lambda x, y: True), "answered with the shape"),  # noqa: ARG005
        (em.WithAdjoint(U, U), em.Goal.integral(lambda x, y: x * y), "of float64 for points"),
        (em.WithAdjoint(U, U), em.Goal.integral(lambda x, y: x > 0.5 and y > 0.5), "use functions of numpy"),
        (em.WithAdjoint(U, U), em.Goal.over_side(["left"]), "no side"),  # type: ignore[arg-type]
        (em.WithAdjoint(U, U), em.Goal(lambda mesh: mesh.x * math.nan), "infinite, where each node needs a number"),
        (em.WithAdjoint(U, U), em.Goal.point(0.3, 0.4, diffusion=1.0, source=1.0), "name them in fixed"),
        (
            em.WithAdjoint(U, U, fixed=SIDE),
            em.Goal.point(0.3, 0.4, diffusion=1.0, source=lambda x, y: x[:1]),  # noqa: ARG005
            "the source has answered",
        ),
    ],
)
def test_what_cannot_be_used_is_a_sentence(returned: Any, goal: em.Goal, words: str) -> None:
    with pytest.raises(BadValues, match=words):
        goal_values(returned, MESH, goal)


@pytest.mark.parametrize(
    ("field", "equation"),
    [
        ("diffusion", {"diffusion": math.nan}),
        ("diffusion", {"diffusion": -1.0}),
        ("stream", {"stream": (1.0, 2.0, 3.0)}),
        ("stream", {"stream": 1.0}),
        ("reaction", {"reaction": "1"}),
        ("source", {"diffusion": 1.0, "source": "1"}),
        ("source", {"diffusion": 1.0, "source": math.inf}),
        ("diffusion", {"source": 1.0}),
    ],
)
def test_an_equation_without_numbers_is_refused(field: str, equation: dict[str, Any]) -> None:
    with pytest.raises(em.InputError, match=r"of (the|an) equation") as caught:
        em.Goal.point(0.1, 0.2, **equation)
    assert caught.value.field == field


def test_what_makes_no_functional_is_refused() -> None:
    with pytest.raises(em.InputError, match="from a mesh to the weights"):
        em.Goal(1.0)  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="give a function, such as lambda x, y"):
        em.Goal.integral("x > 0.5")  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="give two finite numbers"):
        em.Goal.point(math.nan, 0.5)


PRODUCTS = ErrorProducts(bound=8.0, diffusion=1.0, stream_x=0.1, stream_y=0.01, reaction=0.001)


@pytest.mark.parametrize(
    ("equation", "own", "record"),
    [
        ({}, None, GoalRecord(value=3.0, error=None, bound=8.0)),
        ({"diffusion": 2.0}, None, GoalRecord(value=3.0, error=2.0, bound=16.0)),
        ({"diffusion": 2.0}, 0.5, GoalRecord(value=3.0, error=0.5, bound=16.0)),
        (
            {"diffusion": 2.0, "stream": (1.0, 2.0), "reaction": 4.0},
            None,
            GoalRecord(value=3.0, error=2.124, bound=16.0),
        ),
    ],
)
def test_the_error_is_that_of_the_equation_or_of_the_solver(
    equation: dict[str, Any], own: float | None, record: GoalRecord
) -> None:
    goal = em.Goal.integral(**equation)
    found = goal.record(GoalValues(u=U, z=U, value=3.0, error=own), PRODUCTS)
    assert (found.value, found.error, found.bound) == (record.value, pytest.approx(record.error), record.bound)
    assert found.corrected == pytest.approx(3.0 + (record.error or 0.0))


def test_products_tell_nothing_of_a_value_at_a_point() -> None:
    found = goal_values(em.WithAdjoint(U, U), MESH, POINT)
    assert em.Goal.point(0.3, 0.4, diffusion=1.0).record(found, PRODUCTS).error is None


def test_products_are_written_and_read() -> None:
    estimate = Estimate(l2=1.0, h1=2.0, unresolved=0.1, moved_cells=0.5, products=PRODUCTS)
    assert Estimate.from_json(estimate.to_json()) == estimate
