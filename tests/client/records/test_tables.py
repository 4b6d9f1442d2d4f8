"""Tables of text, and the numbers in them."""

from __future__ import annotations

import numpy as np

from equimesh_client.records.measures import align, number


def test_tables() -> None:
    assert align(["a", "bb"], [["ccc", "1"]]) == "a    bb\n-------\nccc   1"
    cases = {0.0: "0.0000", 1e-3: "0.0010", 9e-4: "9.000e-04", -2e5: "-2.000e+05", np.inf: "inf", np.nan: "-"}
    assert {value: number(value) for value in cases} == cases
