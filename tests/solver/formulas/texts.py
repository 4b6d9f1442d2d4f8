"""The values of a formula at a point, and the error that refuses one at its place."""

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


def check_refused_at(text: str, offset: int, words: str) -> None:
    """The text is refused at this place, with a message that says ``words`` and can be sent."""
    error = refused(text, alpha=1.0)
    assert words in error.message
    assert error.position.offset == offset
    assert error.field == "expression"
    error.message.encode()
