"""Domains of every kind, a straight curve, points of the unit square, and the error with which something is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em

S, T = np.random.default_rng(11).random((2, 40, 30))


def wavy(**changed: em.Curve) -> em.Quadrilateral:
    """A square with three curved sides, one of which runs unevenly, and one spline."""
    k = np.linspace(0, 1, 21)
    sides = {
        "bottom": em.Curve.of_expressions("t", "0.2*sin(pi*t)"),
        "right": em.Curve.of_expressions("1 + h*sin(pi*t)", "t + 0.1*t*(1 - t)", {"h": 0.1}),
        "top": em.Curve.of_expressions("t", "1 + 0.1*sin(2*pi*t)"),
        "left": em.Curve.through(np.column_stack([-0.1 * np.sin(np.pi * k), k])),
    }
    return em.Quadrilateral(**(sides | changed))


DOMAINS: dict[str, em.Domain] = {
    "square": em.Rectangle(),
    "rectangle": em.Rectangle(x=(-3, 1), y=(2, 2.5)),
    "quarter": em.AnnulusSector(),
    "sector": em.AnnulusSector(center=(3, -1), radii=(0.2, 0.5), angles=(-70, 200)),
    "ring": em.AnnulusSector(angles=(-180, 180)),
    "quadrilateral": wavy(),
}


def refusal(make: Any, *arguments: Any, **options: Any) -> em.InputError:
    with pytest.raises(em.InputError) as caught:
        make(*arguments, **options)
    return caught.value


def line(x0: float, y0: float, x1: float, y1: float) -> em.Curve:
    return em.Curve.through([[x0, y0], [x1, y1]])
