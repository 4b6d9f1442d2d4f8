"""The ten geometries: sizes, areas, nodes that slide."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from equimesh.testing.geometries import DESCRIPTIONS, GEOMETRIES

PROFILE = 0.081706  # the area of NACA 0012 with a closed edge, by the integral of its polynomial
AREAS = {
    "l_shape": 3.0,
    "step": 4.5,
    "obstacle": 7.75,
    "plus": 5.0,
    "ring": 3 * math.pi,
    "disc": math.pi,
    "cylinder": 8.5 * 4 - math.pi / 4,
    "naca0012_o": 16 * math.pi - PROFILE,
    "naca0012_c": 4.5 * math.pi + 24 - PROFILE,
    "pitz_daily": 20.6 * 25.4 + 206 * 50.8 + 84 * 0.5 * (50.8 + 33.2),
}


def test_the_area_of_the_profile() -> None:
    a, b, c, d, e = 1.4845, -0.63, -1.758, 1.4215, -0.518
    assert 2 * 0.12 * (a / 1.5 + b / 2 + c / 3 + d / 4 + e / 5) == pytest.approx(PROFILE, rel=1e-9)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_each_has_the_requested_size_and_its_area_and_no_fold(name: str) -> None:
    found = GEOMETRIES[name](1500)
    assert found.points == pytest.approx(1500, rel=0.08)
    assert not found.mesh.is_folded
    assert found.area == pytest.approx(AREAS[name], rel=1e-7)
    assert found.points == found.layout.node_count == len(np.unique(found.mesh.cells))
    assert found.description()["blocks"] == DESCRIPTIONS[name]["blocks"]


def test_the_names_are_those_of_the_functions() -> None:
    assert list(GEOMETRIES) == list(DESCRIPTIONS)
    assert [function.__name__ for function in GEOMETRIES.values()] == list(GEOMETRIES)


def test_cells_of_neighbours_have_nearly_one_size_across_the_step() -> None:
    found = GEOMETRIES["pitz_daily"](12_500)
    assert [block.shape for block in found.mesh.blocks][1] == (181, 28)
    upright = np.concatenate([found.mesh.block_mesh(1).y[90], found.mesh.block_mesh(2).y[90, 1:]])
    heights = np.diff(upright)
    assert max(max(a / b, b / a) for a, b in pairwise(heights)) < 1.55
