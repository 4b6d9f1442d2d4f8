"""Numbers of a text: to the last bit, and the line of a word that is none."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.bounds import floats, integers, line_of


def test_numbers_are_read_to_the_last_bit() -> None:
    values = np.random.default_rng(1).standard_normal(200) * 10.0 ** np.arange(-100, 100)
    np.testing.assert_array_equal(floats("\n ".join(map(repr, values.tolist())).encode(), 1, "values"), values)
    assert integers(b" 3 -4\t5\n", 1, "values").tolist() == [3, -4, 5]
    assert floats(b" \n", 1, "values").size == 0


@pytest.mark.parametrize(
    ("text", "told"), [(b"1 2\n3 4x 5", "line 8: '4x' is no integer"), (b"1\n\n2.5", "line 9: '2.5'")]
)
def test_the_line_of_a_wrong_word(text: bytes, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        integers(text, 7, "the cells")
    assert "among the cells" in caught.value.message


def test_the_line_of_a_byte() -> None:
    assert [line_of(b"a\nb\n", k) for k in range(4)] == [1, 1, 2, 2]
