"""The nodes along the sides, in full."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.sweeps.sides import SideNodes

SHAPE = (130, 2049)
X, Y = np.random.default_rng(5).random((2, *SHAPE))


def test_every_part_gets_all_sides() -> None:
    def work(channel: Channel) -> SideNodes:
        parts = Parts.of(SHAPE, 1, channel)
        return SideNodes.gathered(X[parts.held], Y[parts.held], parts)

    whole = SideNodes.of(X, Y)
    assert np.array_equal(whole.along_eta, Y[[0, -1]])
    assert np.array_equal(whole.along_xi, X[:, [0, -1]].T)
    for count in (1, 2, 3, 5):
        for found in ThreadChannels(count).run(work):
            assert all(np.array_equal(one, other) for one, other in zip(found, whole, strict=True))


def test_moved_sides_are_new_ones() -> None:
    whole = SideNodes.of(X, Y)
    moved = whole.moved(whole.along_eta, -whole.along_xi)
    assert np.array_equal(moved.along_eta, 2 * Y[[0, -1]])
    assert not moved.along_xi.any()
