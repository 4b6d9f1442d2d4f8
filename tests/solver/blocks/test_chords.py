"""Edges between points of a curve, and the area between them and the curve."""

import math

import numpy as np
import pytest

from equimesh.blocks.curves import Chords, Circle, Line

COUNT = 24
ANGLES = np.linspace(-math.pi, math.pi, COUNT, endpoint=False)
RING = np.stack([np.arange(COUNT), np.roll(np.arange(COUNT), -1)], axis=1)
POINTS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
STEP = 2.0 * math.pi / COUNT


def chords(slides: np.ndarray, edges: np.ndarray = RING) -> Chords | None:
    return Chords.of(Circle(), edges, slides, POINTS, np.where(slides, ANGLES, 0.0))


@pytest.mark.parametrize("fixed", [[], [0], [5, 6, 11]])
def test_the_circle_is_closed_and_fixed_nodes_are_ends_of_its_pieces(fixed: list[int]) -> None:
    slides = ~np.isin(np.arange(COUNT), fixed)
    found = chords(slides)
    assert found is not None
    pieces = COUNT - (5 in fixed)  # an edge between two fixed nodes does not change
    assert len(found.nodes) == pieces
    assert found.cut_off(ANGLES) == pytest.approx(0.5 * pieces * (STEP - math.sin(STEP)), rel=3e-3)


def test_longer_edges_cut_off_more_also_beyond_the_begin_of_the_circle() -> None:
    found = chords(np.ones(COUNT, dtype=bool))
    assert found is not None
    moved = ANGLES + 0.9 * np.sin(ANGLES) + 2.0
    lengths = np.diff(np.append(moved, moved[0] + 2.0 * math.pi))
    assert found.cut_off(moved) == pytest.approx(0.5 * float((lengths - np.sin(lengths)).sum()), rel=1e-2)


def test_lines_and_nodes_elsewhere_have_none() -> None:
    everywhere = np.ones(COUNT, dtype=bool)
    assert Chords.of(Line(start=(0.0, 0.0), end=(1.0, 0.0)), RING, everywhere, POINTS, ANGLES) is None
    assert chords(~everywhere) is None
    slides = everywhere.copy()
    slides[3] = False
    away = POINTS.copy()
    away[:, 3] *= 0.5
    found = Chords.of(Circle(), RING, slides, away, ANGLES)
    assert found is not None
    assert len(found.nodes) == COUNT - 2
