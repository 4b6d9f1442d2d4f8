"""Rows of a text file from tables of integers."""

from __future__ import annotations

import numpy as np

from equimesh.io.solver_files import integer_rows


def test_every_row_has_its_numbers_in_the_form() -> None:
    table = np.array([[1, -2, 3], [40, 5, 2**40]])
    assert integer_rows("3(%d %d %d)", table) == ["3(1 -2 3)", f"3(40 5 {2**40})"]
    assert integer_rows("%d", np.empty((0, 1), dtype=np.int64)) == []
