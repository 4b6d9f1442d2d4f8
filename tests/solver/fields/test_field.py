"""What is a field, and what is refused as one."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.field import require_field

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


@pytest.mark.parametrize("wrong", ["x*y", 3.0, None, np.zeros(3), {"evaluate": 1}])
def test_anything_else_is_refused_with_what_to_write(wrong: object) -> None:
    with pytest.raises(em.InputError, match=r"em\.Expression\('\.\.\.'\)") as caught:
        require_field(wrong, "rho")  # type: ignore[arg-type]
    assert caught.value.field == "rho"
