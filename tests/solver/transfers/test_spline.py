"""Values at nodes by splines."""

from __future__ import annotations

import numpy as np

from equimesh.transfers.transfer import transfer_spline
from solver.fields.bent_meshes import smooth_mesh


def test_the_components_of_a_vector_are_carried_by_themselves() -> None:
    old, new = smooth_mesh(9), smooth_mesh(12, depth=0.02)
    values = np.stack([np.sin(old.x), old.y**2], axis=-1)
    both = transfer_spline(old, {"v": values}, new)["v"]
    assert both.shape == (12, 15, 2)
    for k in range(2):
        assert np.array_equal(both[..., k], transfer_spline(old, {"u": values[..., k]}, new)["u"])
    assert np.abs(both[..., 0] - np.sin(new.x)).max() < 1e-3
