"""Parts of curves: the way of an edge, and its nodes by length."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import Airfoil
from equimesh.blocks.curves import Circle, Line, parameters_at, span

NAMES = {"name": "a-b", "field": "domain.edges[0].on"}


def test_the_shorter_way_is_taken_unless_a_point_is_named() -> None:
    circle = Circle(radius=2.0)
    assert span(circle, 3.0, -3.0, via=None, **NAMES) == pytest.approx([3.0, 2 * math.pi - 3.0])
    assert span(circle, -3.0, 3.0, via=None, **NAMES) == pytest.approx([-3.0, 3.0 - 2 * math.pi])
    assert span(circle, -3.0, 3.0, via=(2.0, 0.0), **NAMES) == pytest.approx([-3.0, 3.0])
    assert span(circle, 1.0, 1.0, via=None, **NAMES) == pytest.approx([1.0, 1.0 + 2 * math.pi])
    assert span(Line(start=(0.0, 0.0), end=(1.0, 0.0)), 0.7, 0.2, via=None, **NAMES).tolist() == [0.7, 0.2]


def test_two_ways_of_one_length_need_a_point() -> None:
    with pytest.raises(em.InputError, match=r'edge a-b can take two ways .* "via", such as \[.*\]') as caught:
        span(Airfoil(digits="0012"), 0.0, 1.0, via=None, **NAMES)
    assert caught.value.field == "domain.edges[0].on"
    assert span(Airfoil(digits="0012"), 0.0, 1.0, via=(0.5, -0.1), **NAMES).tolist() == [0.0, -1.0]


@pytest.mark.parametrize("ends", [(0.1, 0.95), (0.95, 0.1)])
def test_nodes_stand_at_shares_of_the_length(ends: tuple[float, float]) -> None:
    foil = Airfoil(digits="0012")
    shares = np.linspace(0.0, 1.0, 6)
    t = parameters_at(foil, np.array(ends), shares)
    assert (t[0], t[-1]) == ends
    lengths = []
    for first, last in pairwise(t):
        x, y, *_ = foil.evaluate(np.linspace(first, last, 20_001))
        lengths.append(np.hypot(np.diff(x), np.diff(y)).sum())
    assert lengths == pytest.approx([np.mean(lengths)] * 5, rel=1e-7)


def test_nodes_of_a_circle_are_exact() -> None:
    t = parameters_at(Circle(), np.array([0.0, 1.0]), np.array([0.0, 0.25, 1.0]))
    assert t.tolist() == [0.0, 0.25, 1.0]
