"""A solve in parts."""

from __future__ import annotations

from equimesh.parts.solve import MAX_COARSE_POINTS


def test_the_coarse_solution_fits_into_one_process() -> None:
    assert MAX_COARSE_POINTS * 16 < 20e6
