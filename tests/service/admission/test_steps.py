"""Steps of a sequence, read from JSON and from npz."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from equimesh_service.admission.steps import read_arrays, read_json
from equimesh_service.problems.problem import Problem
from service.requests import npz

U = np.arange(12.0).reshape(4, 3)


def test_a_step_is_the_same_in_json_and_in_npz() -> None:
    move = read_json(b'{"step": 3, "u": {"nodes": [[1, 2], [3, 4]]}, "fields": {"v": [[5, 6], [7, 8]]}}')
    arrays = read_arrays(npz(step=3, u=[[1.0, 2.0], [3.0, 4.0]], v=[[5.0, 6.0], [7.0, 8.0]]), 10_000)
    assert move.step == arrays.step == 3
    np.testing.assert_array_equal(move.u, arrays.u)
    assert move.fields.keys() == arrays.fields.keys() == {"v"}
    np.testing.assert_array_equal(move.fields["v"], arrays.fields["v"])


@pytest.mark.parametrize(
    ("arrays", "pointer", "words"),
    [
        ({"u": U}, "/step", "needs an array step"),
        ({"step": 1}, "/u", "needs an array u"),
        ({"step": [1, 2], "u": U}, "/step", "a single whole number"),
        ({"step": 1.0, "u": U}, "/step", "a single whole number"),
        ({"step": 1, "u": U} | {f"v{k}": U for k in range(33)}, "/fields", "at most 32"),
    ],
)
def test_what_is_no_step_is_refused(arrays: dict[str, Any], pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        read_arrays(npz(**arrays), 100_000)
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message
