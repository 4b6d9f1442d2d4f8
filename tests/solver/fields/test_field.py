"""What is a field, and what is refused as one."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.expression import require_field

AXIS = np.linspace(0, 1, 5)


@pytest.mark.parametrize(
    "field",
    [
        em.Expression("x*y"),
        em.GridSamples(x=AXIS, y=AXIS, values=np.outer(AXIS, AXIS)),
        em.ScatteredSamples(points=[[0, 0], [0, 1], [1, 0], [1, 1]], values=[0, 0, 0, 1]),
    ],
    ids=lambda field: type(field).__name__,
)
def test_every_field_is_one(field: em.Expression) -> None:
    assert require_field(field, "u") is field
    for order, count in enumerate((1, 3, 6)):
        found = field.evaluate(AXIS[1:4], AXIS[1:4], order)
        assert [np.shape(part) for part in found] == [(3,)] * count


@pytest.mark.parametrize("wrong", [3.0, None, np.zeros(3), {"evaluate": 1}])
def test_anything_else_is_refused_with_what_to_write(wrong: object) -> None:
    with pytest.raises(em.InputError, match=r"em\.Expression\('\.\.\.'\)") as caught:
        require_field(wrong, "rho")
    assert caught.value.field == "rho"


def test_a_text_is_an_expression() -> None:
    assert require_field("x*y", "u") == em.Expression("x*y")
    tensor = em.Tensor(m11="1 + x", m12="0", m22="2", u="tanh(x)")  # type: ignore[arg-type]
    assert (tensor.m11, tensor.u) == (em.Expression("1 + x"), em.Expression("tanh(x)"))
    for monitor in (em.ArcLength, em.Curvature, em.LeastError, em.Auto):
        assert monitor(u="x*y").u == em.Expression("x*y")  # type: ignore[arg-type]
    weight = em.Weight(rho="1 + x", u="y")  # type: ignore[arg-type]
    assert (weight.rho, weight.u) == (em.Expression("1 + x"), em.Expression("y"))


def test_a_text_that_is_no_expression_names_the_function_and_the_column() -> None:
    with pytest.raises(em.ExpressionError, match="did you mean tanh") as caught:
        em.Weight(rho="1 + tnah(x)")  # type: ignore[arg-type]
    assert caught.value.field == "rho"
    assert caught.value.position is not None
    assert caught.value.position.column == 5
