"""Parts that are threads."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem
from equimesh_cluster.parts.solve import coarse_solution, solve_in_threads


def test_more_parts_than_the_grids_have_strips_are_refused() -> None:
    case = problem("ring", 129)
    with pytest.raises(em.InputError, match="can be cut into at most 1 parts"):
        solve_in_threads(case, 2, coarse_solution(case, max_points=65 * 65))
