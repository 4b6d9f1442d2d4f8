"""Areas, centroids and weights of corners."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.transfers.integrals import measures_of


def test_a_trapezium() -> None:
    found = measures_of(np.array([[[0.0, 2.0, 1.0, 0.0]], [[0.0, 0.0, 1.0, 1.0]]]))
    assert found.area[0] == 1.5
    assert (found.x[0], found.y[0]) == (pytest.approx(7 / 9), pytest.approx(4 / 9))
    assert found.weights.sum() == pytest.approx(1.5)
    # The integral of a linear function by its corners is that of the centroid.
    assert found.weights[0] @ [0.0, 2.0, 1.0, 0.0] == pytest.approx(1.5 * 7 / 9)
    assert found.weights[0] @ [0.0, 0.0, 1.0, 1.0] == pytest.approx(1.5 * 4 / 9)
