"""Newton steps on the whole grid: taken where a subdomain stalled or the mesh folded, and counted in a row."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.schwarz import iteration as module
from equimesh.schwarz.iteration import Rescue, newton_step
from solver.schwarz.bent import bent, distance
from solver.schwarz.runs import PAPER, WHOLE
from solver.schwarz.solved import solved

SOLUTION = bent(PAPER, 0.0)
NEAR = bent(PAPER, 0.001)
FOLDED = em.Mesh(NEAR.x[::-1].copy(), NEAR.y)


def test_without_need_the_merged_mesh_stays() -> None:
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR), SOLUTION)
    assert found.mesh is NEAR
    assert not found.is_stepped
    assert not rescue.has_stepped
    assert rescue.residuals == []


def test_a_step_starts_from_the_merged_mesh_and_leads_towards_the_solution() -> None:
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR, stalled=True), SOLUTION)
    assert found.is_stepped
    assert distance(found.mesh, SOLUTION) < 0.1 * distance(NEAR, SOLUTION)
    assert rescue.residuals == [newton_step(PAPER, WHOLE, NEAR)[1]]


def test_a_folded_mesh_is_left_for_the_one_before() -> None:
    found = Rescue(PAPER, WHOLE).apply(solved(FOLDED), NEAR)
    assert found.is_stepped
    assert np.array_equal(found.mesh.x, newton_step(PAPER, WHOLE, NEAR)[0].x)


def test_only_steps_in_a_row_count() -> None:
    rescue = Rescue(PAPER, WHOLE)
    for _ in range(2):
        rescue.apply(solved(NEAR, stalled=True), NEAR)
    assert not rescue.has_failed
    rescue.apply(solved(NEAR), NEAR)
    assert rescue.residuals == []
    for k in range(3):
        assert rescue.has_failed is False, k
        rescue.apply(solved(NEAR, stalled=True), NEAR)
    assert rescue.has_failed
    assert rescue.is_stuck, "three times the same step"


@pytest.mark.parametrize(
    ("residuals", "stuck"),
    [
        ([1.0, 1.0], False),
        ([1.0, 1.0, 0.95], True),
        ([1.0, 1.0, 0.5], False),
        ([9.0, 1.0, 1.0, 1.0], True),
        ([math.inf] * 3, True),
        ([1.0, 1.0, math.nan], True),
    ],
    ids=str,
)
def test_steps_that_do_not_lower_the_residual_lead_nowhere(residuals: list[float], stuck: bool) -> None:
    rescue = Rescue(PAPER, WHOLE)
    rescue.residuals = residuals
    assert rescue.is_stuck is stuck


def test_large_grids_are_not_factorised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FACTORISED_POINTS", PAPER.grid.points - 1)
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR, stalled=True), SOLUTION)
    assert np.array_equal(found.mesh.x, NEAR.x)
    assert found.mesh.x is not NEAR.x, "a copy"
    assert rescue.residuals == [math.inf]
