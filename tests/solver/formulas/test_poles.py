"""Poles between the points of a grid are found, on any domain, and steep fronts are no poles."""

from __future__ import annotations

import math
import re

import pytest

import equimesh as em
from equimesh.errors import ExpressionError
from equimesh.fields.expression import Expression


@pytest.mark.parametrize("shift", [0.0, 100.0, 1e5])
def test_it_finds_poles_between_its_points_away_from_the_origin(shift: float) -> None:
    domain, parameters = em.Rectangle(x=(shift, shift + 1)), {"m": shift, "d": 1e-17 * max(1.0, shift)}
    poles = ("1/(x - m - 1/3)", "sqrt(abs(x - m - 1/3))", "1/(x - m - 0.25 + d)")  # d: a rounding error
    for pole in poles:
        with pytest.raises(em.ExpressionError, match="grows without bound"):
            em.Expression(pole, parameters=parameters).check_finite(domain=domain)
    em.Expression("tanh(1000*(x - m - 1/3))", parameters=parameters).check_finite(domain=domain)


def test_it_finds_poles_in_a_sector() -> None:
    with pytest.raises(em.ExpressionError, match="grows without bound") as caught:
        em.Expression("1/(hypot(x, y) - 4/3)").check_finite(domain=em.AnnulusSector())
    x, y = (float(part) for part in caught.value.message.split("= (")[1].split(")")[0].split(","))
    assert math.hypot(x, y) == pytest.approx(4 / 3, rel=1e-4)


POLES = [
    ("1/(x - 1/3)", (1 / 3, None), "1/(x - 1/3)", "denominator"),
    ("y + tan(pi*x)", (0.5, None), "tan(pi*x)", "3*pi/2"),
    ("1e-9/((x - 0.3)**2 + (y - 0.7)**2)", (0.3, 0.7), "1e-9/(", "denominator"),
    ("tanh(30*(y - x)) + log(abs(y - 0.41))", (None, 0.41), "log(", "positive"),
    ("sqrt(abs(x - 0.71))", (0.71, None), "sqrt(", "finite slope"),
    ("sqrt((x - 1/3)**2 - 1e-6)", (None, None), "sqrt(", "positive"),  # not defined between two points of the grid
    ("atan2(y - 0.41, x - 0.3)", (0.3, 0.41), "atan2(", "out of the unit square"),
    ("where(x < 0.3, 1, 1/(x - 0.31))", (0.31, None), "1/(x - 0.31)", "denominator"),
]


@pytest.mark.parametrize(("text", "place", "part", "remedy"), POLES, ids=[pole[0] for pole in POLES])
def test_check_finite_finds_poles_between_the_points_of_its_grid(
    text: str, place: tuple[float | None, float | None], part: str, remedy: str
) -> None:
    with pytest.raises(ExpressionError, match="gradient of u grows without bound at") as caught:
        Expression(text).check_finite()
    error = caught.value
    found = re.search(r"\(x, y\) = \(([^,]+), ([^)]+)\)", error.message)
    assert found is not None
    for expected, shown in zip(place, found.groups(), strict=True):
        assert expected is None or float(shown) == pytest.approx(expected, abs=1e-5)
    assert error.position is not None
    assert text[error.position.offset :].startswith(part)
    assert remedy in error.message
