"""Programs: blocks of points, equal parts, constants, and what is evaluated without derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given

from equimesh.fields.expression import FUNCTIONS, LIMITS, Expression
from solver.formulas.random_formulas import (
    LARGE,
    SMOOTH,
    STEP,
    TooClose,
    Tree,
    coordinate,
    seeded,
    text_of,
    trees,
    value_of,
)


def test_blocks_join_without_a_seam() -> None:
    x = np.linspace(0, 1, 3 * 16384 + 17)
    for part, wanted in zip(Expression("x**3*y").evaluate(x, 2 * x, 2), (2 * x**4, 6 * x**3, x**3), strict=False):
        np.testing.assert_allclose(part, wanted, rtol=1e-14)


def test_results_do_not_alias_the_input() -> None:
    x = np.linspace(0, 1, 5)
    (u,) = Expression("x").evaluate(x, x)
    u[:] = 7.0
    assert x[0] == 0.0


def test_equal_parts_are_evaluated_once_and_constants_never() -> None:
    def steps(text: str) -> list[str]:
        return [step.name for step in Expression(text, parameters={"k": 2.0})._program.steps]

    assert steps("sin(x*y)**2 + cos(x*y) + sin(x*y)").count("*") == 1
    assert steps("sin(x*y) + sin(x*y)").count("sin") == 1
    assert steps("(2*pi/k)*x") == ["x", "*"]
    assert steps("where(k > 1, x, log(x))") == ["x"]
    assert steps("1 + 2*k") == []


def test_what_only_a_condition_needs_has_no_derivatives() -> None:
    steps = Expression("where(sin(x) < 0.5, y**2, sign(cos(y)))")._program.steps
    assert {step.name for step in steps if step.value_only} == {"<", "sin", "x", "cos"}
    shared = Expression("where(sin(x) < 0.5, sin(x), y)")._program.steps
    assert [step.value_only for step in shared if step.name == "sin"] == [False]


def test_equal_numbers_of_different_sign_are_not_merged() -> None:
    u = Expression("atan2(where(x < 0.5, 0.0, -0.0), -1)")
    assert u.evaluate([0.0, 1.0], [0.0, 0.0])[0].tolist() == [math.pi, -math.pi]


def test_the_evaluator_knows_every_function() -> None:
    assert {*FUNCTIONS} <= {*SMOOTH, "where"}


@seeded
@given(tree=trees, x=coordinate, y=coordinate)
def test_value_and_gradient(tree: Tree, x: float, y: float) -> None:
    try:
        along_x = value_of(tree, complex(x, STEP), complex(y))
        along_y = value_of(tree, complex(x), complex(y, STEP))
    except TooClose:
        assume(False)
    u = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3)
    value, u_x, u_y = (float(part) for part in u.evaluate(x, y, order=1))
    assert value == pytest.approx(along_x.real, rel=1e-7, abs=1e-7)
    assert u_x == pytest.approx(along_x.imag / STEP, rel=1e-6, abs=1e-6)
    assert u_y == pytest.approx(along_y.imag / STEP, rel=1e-6, abs=1e-6)


@seeded
@given(tree=trees, x=coordinate, y=coordinate)
def test_hessian(tree: Tree, x: float, y: float) -> None:
    """The Hessian against differences of the gradient, where two step sizes agree on these."""
    try:
        value_of(tree, complex(x), complex(y))
    except TooClose:
        assume(False)
    u, h = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3), 1e-4
    points = np.array([(x + s * h, y) for s in (-2, -1, 1, 2)] + [(x, y + s * h) for s in (-2, -1, 1, 2)]).T
    _, u_x, u_y = u.evaluate(points[0], points[1], order=1)
    *_, u_xx, u_xy, u_yy = u.evaluate(x, y, order=2)
    assume(bool(np.isfinite([*u_x, *u_y]).all()) and max(np.abs([*u_x, *u_y])) < LARGE)
    compared = 0
    for slopes, part in ((u_x[:4], u_xx), (u_x[4:], u_xy), (u_y[:4], u_xy), (u_y[4:], u_yy)):
        near, far = (slopes[2] - slopes[1]) / (2 * h), (slopes[3] - slopes[0]) / (4 * h)
        if abs(near - far) < 1e-4 * (1 + abs(near)):
            compared += 1
            assert float(part) == pytest.approx(near, rel=1e-3, abs=1e-3 * (1 + max(np.abs(slopes)) / 10))
    assume(compared > 0)


@seeded
@given(tree=trees)
def test_arrays_agree_with_single_points(tree: Tree) -> None:
    u = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3)
    x, y = np.linspace(0, 1, 5), np.linspace(1, 0, 5)
    together = u.evaluate(x, y, order=2)
    alone = np.transpose([u.evaluate(x[i], y[i], order=2) for i in range(5)])
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9)
    for order in (0, 1):
        for few, many in zip(u.evaluate(x, y, order), together, strict=False):
            np.testing.assert_array_equal(few, many)


LARGEST = [
    "+".join(f"x*{k}" for k in range(1, 251)),
    "+".join(f"erf({k}*x+y)" for k in range(1, 143)),
    "where(x<0.5," * 99 + "x" + ",y)" * 99,
    f"max({','.join(f'x*{k}' for k in range(1, 334))})",
    "**".join(["x"] * 100),
]


@pytest.mark.parametrize("text", LARGEST, ids=[text[:8] for text in LARGEST])
def test_the_largest_expressions_are_programs_of_few_steps(text: str) -> None:
    """At most 1000 operations for each point, with all derivatives."""
    u = Expression(text)
    assert 100 <= len(u._program.steps) <= LIMITS.nodes == 1000
    x, y = np.random.default_rng(1).random((2, 1000))
    assert all(part.shape == x.shape for part in u.evaluate(x, y, order=2))
