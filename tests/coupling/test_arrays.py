"""Arrays from outside."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh_coupling import BadValues
from equimesh_coupling.arrays import finite, real


def test_numbers_become_floats() -> None:
    assert real([1, 2], "u").dtype == np.float64
    assert finite(real([[1.5]], "u"), "u").tolist() == [[1.5]]


def test_what_is_no_number_is_refused_by_its_type() -> None:
    with pytest.raises(BadValues, match=r"the solution is a builtins.dict, which is no array of numbers"):
        real({"u": 1}, "the solution")
    with pytest.raises(BadValues, match=r"u is a builtins.list"):
        real([[1.0], [1.0, 2.0]], "u")
    with pytest.raises(BadValues, match="the solution has complex numbers: give real ones"):
        real([1j], "the solution")


def test_a_diverged_solver_is_named() -> None:
    with pytest.raises(BadValues, match="the solution has 2 of 3 values that are nan or infinite, so the solver div"):
        finite(np.array([1.0, np.nan, np.inf]), "the solution")


def test_the_array_is_a_copy() -> None:
    own = np.ones(3)
    taken = real(own, "u")
    own[:] = 2.0
    assert taken.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "values", [np.ma.masked_equal([1.0, 2.0], 2.0), ["1.5"], np.array(["2020-01-01"], dtype="M8[D]"), [10**400]]
)
def test_what_are_no_numbers_is_refused(values: object) -> None:
    with pytest.raises(BadValues):
        real(values, "u")
