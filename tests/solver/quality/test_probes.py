"""Probes of u between the nodes."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.quality.interpolation import MAX_PROBES_PER_CELL, PROBES, probe_errors
from solver.quality.handmade import uniform, wavy


def test_what_vanishes_at_the_nodes_is_seen_between_them() -> None:
    found, variation = probe_errors(uniform(65), em.Expression("sin(64*pi*x)*sin(64*pi*y)"))
    assert found.value == pytest.approx(1.0, abs=0.01)
    assert variation == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("mesh", [uniform(33), wavy(21, 40)])
def test_a_spike_between_the_nodes_is_found_in_its_place(mesh: em.Mesh) -> None:
    found, _ = probe_errors(mesh, em.Expression("exp(-5e4*((x - 0.4033)**2 + (y - 0.7077)**2))"))
    assert found.value > 0.5
    assert (found.x, found.y) == pytest.approx((0.4033, 0.7077), abs=0.01)


def test_a_bilinear_function_has_no_error() -> None:
    found, variation = probe_errors(uniform(9, 12), em.Expression("1 + 2*x - 3*x*y"))
    assert found.value < 1e-14
    assert variation == pytest.approx(3.0)


def test_values_that_are_not_finite_are_left_out() -> None:
    found, variation = probe_errors(uniform(9), em.Expression("y + 0/(x - 0.5)"))
    assert found.value < 1e-14
    assert variation == pytest.approx(1.0)


def test_the_number_of_probes_is_bounded() -> None:
    seen: list[int] = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            seen.append(x.size)
            return (x * y,) if order == 0 else (x * y, y, x)

    for n, most in ((5, 16 * MAX_PROBES_PER_CELL), (65, PROBES), (300, 299**2)):
        seen.clear()
        probe_errors(uniform(n), Counting())
        assert 0 < sum(seen) - n * n <= most + 2 * n, "a row of nodes between two strips counts twice"
