"""Rectangles of grid points."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.schwarz.decomposition import SubdomainWindow, common, points, rim

BLOCKS = em.Decomposition(grid=em.Grid(n_xi=20, n_eta=14), subdomains=(3, 2), overlap=3)


def test_what_two_rectangles_share() -> None:
    one, other = (slice(0, 5), slice(2, 9)), (slice(3, 8), slice(0, 4))
    assert common(one, other) == (slice(3, 5), slice(2, 4))
    assert points(common(one, other)) == 4
    assert common(one, (slice(5, 8), slice(0, 4))) is None
    assert points(None) == 0


def test_the_rim_is_the_window_without_the_subdomain() -> None:
    for part in BLOCKS.parts:
        window, seen = SubdomainWindow(BLOCKS, part, 1), np.zeros((20, 14), dtype=int)
        seen[window.covered] += 1
        for step, place in rim(window).items():
            seen[place] += 1
            near = BLOCKS.at(part.place[0] + step[0], part.place[1] + step[1])
            assert common(place, (slice(near.columns[0], near.columns[-1] + 1), slice(0, 14))) is not None
        assert (seen[window.slices] == 1).all()
        assert seen.sum() == window.shape[0] * window.shape[1]
