"""Profiles of airfoils: thickness, camber, edges."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import Airfoil


def test_a_symmetric_profile_has_its_thickness_and_closed_edges() -> None:
    foil = Airfoil(digits="0012")
    x, y, *_ = foil.evaluate(np.linspace(0.0, 2.0, 4001))
    assert np.ptp(y) == pytest.approx(0.12, rel=1e-3)
    assert x[y.argmax()] == pytest.approx(0.3, abs=5e-3)
    assert y == pytest.approx(-y[::-1], abs=1e-15)
    assert abs(y[0]) < 1e-15
    assert (x.min(), x.max()) == (0.0, 1.0)
    # Published ordinates in per cent of the chord, at 5, 30 and 60 per cent of it.
    shares = 1.0 - np.sqrt([0.05, 0.30, 0.60])
    assert 100 * foil.evaluate(shares)[1] == pytest.approx([3.555, 6.002, 4.563], abs=0.02)


def test_camber_lifts_the_profile_and_the_angle_turns_it_clockwise() -> None:
    x, y, *_ = Airfoil(digits="2412").evaluate(np.linspace(0.0, 2.0, 4001))
    upper, lower = np.interp(0.4, x[2000::-1], y[2000::-1]), np.interp(0.4, x[2000:], y[2000:])
    assert 0.5 * (upper + lower) == pytest.approx(0.02, abs=1e-4)
    turned = Airfoil(digits="0012", chord=2.0, leading_edge=(1.0, 1.0), angle=30.0)
    at = [part.item() for part in turned.evaluate(np.array(0.0))[:2]]
    assert at == pytest.approx([1 + 2 * np.cos(np.pi / 6), 0.0])


@pytest.mark.parametrize("digits", ["12", "00122", "00a2", "0000", "2012", "0412", "٠٠١٢"])
def test_other_digits_are_refused(digits: str) -> None:
    with pytest.raises(em.InputError, match="naca = ") as caught:
        Airfoil(digits=digits, where="domain.curves.foil.naca")
    assert caught.value.field == "domain.curves.foil.naca"
