"""The wanted density of cells, from an error indicator."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh_coupling.adaptation import wanted_density

AXES = np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2, indexing="ij")


def test_the_density_has_the_power_of_the_norm() -> None:
    indicator = np.ones((8, 8))
    indicator[4:] = 8.0
    for norm, ratio in (("l2", 4.0), ("h1", 8.0)):
        density = wanted_density(*AXES, indicator, norm)
        assert density is not None
        low, high = density[0, 0], density[-1, -1]
        mean = 0.5 * (1.0 + ratio)
        assert high / low == pytest.approx((ratio / mean + 0.1) / (1.0 / mean + 0.1))


def test_equal_indicators_on_a_graded_mesh_keep_its_density() -> None:
    x = np.linspace(0.0, 1.0, 9) ** 2
    graded = np.meshgrid(x, np.linspace(0.0, 1.0, 9), indexing="ij")
    density = wanted_density(*graded, np.ones((8, 8)), "l2")
    assert density is not None
    assert np.all(np.diff(density[:, 0]) <= 1e-12)
    assert density[0, 0] > 5.0 * density[-1, 0]


def test_no_density_where_all_indicators_are_zero() -> None:
    assert wanted_density(*AXES, np.zeros((8, 8)), "l2") is None
