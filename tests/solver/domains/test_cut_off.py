"""Areas between curved sides and their chords."""

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import PLACES, area_between, cut_off, most_cut_off


def test_the_area_of_segments_of_circles() -> None:
    """That of an arc of angle a is (a - sin a) / 2; a segment counts on either side of its chord."""
    for angle, accuracy in ((0.1, 1e-3), (1.0, 2e-2), (math.pi, 0.2)):
        t = np.multiply.outer([1.0, -1.0], angle * np.array(PLACES))
        assert area_between(np.cos(t), np.sin(t)) == pytest.approx(angle - math.sin(angle), rel=accuracy)


def test_a_whole_wave_is_seen_though_its_middle_lies_on_the_chord() -> None:
    t = np.array([PLACES])
    assert area_between(t, np.sin(2.0 * math.pi * t)) == pytest.approx(2.0 / math.pi, rel=0.1)


def test_the_sides_of_a_ring_lose_and_cover_by_the_formula() -> None:
    angles = np.linspace(0.0, 1.0, 41)
    for s, radius in ((0.0, 1.0), (1.0, 2.0)):
        line = np.stack([np.full(angles.size, s), angles])
        found = cut_off(em.AnnulusSector(angles=(0, 360)), line[:, :-1], line[:, 1:])
        step = 2.0 * math.pi / 40
        assert found == pytest.approx(20 * radius**2 * (step - math.sin(step)), rel=3e-3)


def test_the_bound_is_a_share_of_the_area_or_twice_the_initial_one() -> None:
    assert most_cut_off(0.001, 2.0) == pytest.approx(0.501)
    assert most_cut_off(0.6, 2.0) == pytest.approx(1.2)
