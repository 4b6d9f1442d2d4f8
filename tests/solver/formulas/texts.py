"""The values of a formula at a point, and the error that refuses one."""

from __future__ import annotations

import pytest

from equimesh.errors import ExpressionError
from equimesh.fields.expression import Expression


def values(text: str, x: float, y: float, order: int = 2, **parameters: float) -> list[float]:
    return [float(part) for part in Expression(text, parameters=parameters).evaluate(x, y, order)]


def refused(text: str, **parameters: float) -> ExpressionError:
    with pytest.raises(ExpressionError) as caught:
        Expression(text, parameters=parameters)
    return caught.value
