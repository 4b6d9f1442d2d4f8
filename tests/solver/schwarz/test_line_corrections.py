"""Line corrections of the merged mesh: they shrink its error, know how much is left, and fold nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.line_corrections import LineCorrections

CASE = problem("tanh20", 25, 21)
SOLUTION = em.solve(CASE, mode=em.Mode.TIGHT).reference


def disturbed(size: float) -> em.Mesh:
    bump = size * np.sin(np.pi * SOLUTION.x) * np.sin(np.pi * SOLUTION.y)
    return em.Mesh(SOLUTION.x + bump, SOLUTION.y - bump)


def error(mesh: em.Mesh) -> float:
    return float(max(abs(mesh.x - SOLUTION.x).max(), abs(mesh.y - SOLUTION.y).max()))


def test_corrections_lead_to_the_single_domain_solution() -> None:
    errors = [error(LineCorrections(CASE, 1).apply(disturbed(0.01), count).mesh) for count in (1, 3, 6)]
    assert errors[0] < 0.6 * error(disturbed(0.01))
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


@pytest.mark.parametrize("count", [4, 8])
def test_the_estimate_is_no_less_than_the_error(count: int) -> None:
    found = LineCorrections(CASE, 1).apply(disturbed(0.01), count)
    assert found.count == count
    assert 0.3 * error(found.mesh) < found.estimate < 30 * error(found.mesh)
    assert 0.0 < found.deviation < 0.1


def test_they_end_where_the_error_left_is_small_enough() -> None:
    found = LineCorrections(CASE, 1).apply(disturbed(0.01), 50, enough=1e-4)
    assert 1 < found.count < 50
    assert found.estimate <= 1e-4
    assert error(found.mesh) < 1e-3


def test_none_of_them_leaves_the_mesh_as_it_was() -> None:
    start = disturbed(0.01)
    found = LineCorrections(CASE, 1).apply(em.Mesh(start.x.copy(), start.y.copy()), 0)
    assert np.array_equal(found.mesh.x, start.x)
    assert found.count == 0
    assert math.isnan(found.estimate)
    assert math.isnan(found.deviation)


def test_a_correction_that_would_fold_is_not_taken() -> None:
    steep = problem("tanh20", 33, a=1.0, b=0.0)
    start = em.Mesh.uniform(steep.grid)
    found = LineCorrections(steep, 1).apply(em.Mesh(start.x.copy(), start.y.copy()), 20)
    assert found.count < 20
    assert not found.mesh.is_folded
