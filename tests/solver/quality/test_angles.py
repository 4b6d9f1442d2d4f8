"""Angles at the corners of cells."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import in_blocks, l_shape
from equimesh.meshes.mesh import Mesh
from equimesh.quality.cells import corner_angles, measure_angles
from solver.quality.handmade import folded, one_quad, uniform, wavy


def test_angles_by_hand() -> None:
    trapezium = one_quad((0.0, 0.0), (3.0, 0.0), (2.0, 1.0), (1.0, 1.0))
    assert corner_angles(trapezium)[:, 0] == pytest.approx([45.0, 45.0, 135.0, 135.0])
    found = measure_angles(trapezium, from_degrees=50.0)
    assert (found.smallest, found.largest, found.share_within) == pytest.approx((45.0, 135.0, 0.5))
    assert measure_angles(l_shape(bend=0.0)).summary() == pytest.approx({"min": 90, "max": 90, "share_within": 1})


def test_the_sum_of_a_cell_is_a_full_turn_and_blocks_agree_with_their_grid() -> None:
    grid = wavy()
    whole = in_blocks(grid)
    assert corner_angles(grid).sum(axis=0) == pytest.approx(np.full(12 * 8, 360.0))
    assert measure_angles(whole.mesh).summary() == pytest.approx(measure_angles(grid).summary())
    sheared = Mesh(uniform(5).x + 3 * uniform(5).y, uniform(5).y)
    assert measure_angles(sheared).share_within == 0.0


def test_a_folded_cell_has_an_angle_beyond_a_half_turn() -> None:
    assert measure_angles(folded()).largest > 180.0
    assert measure_angles(wavy()).largest < 180.0
