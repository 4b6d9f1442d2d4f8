"""The Poisson problem that every consumer solves: w given on left, bottom and top, its normal derivative on right."""

from __future__ import annotations

from typing import Any

import numpy as np

# Steepness of the front, and its direction and place: w = tanh(STEEP (x + SLANT y - PLACE)).
STEEP = 20.0
SLANT = 0.5
PLACE = 0.75
FIXED = ("left", "bottom", "top")


def w(x: Any, y: Any) -> Any:
    """The exact solution."""
    return np.tanh(STEEP * (x + SLANT * y - PLACE))


def gradient(x: Any, y: Any) -> tuple[Any, Any]:
    """Its two partial derivatives."""
    slope = STEEP * (1 - w(x, y) ** 2)
    return slope, SLANT * slope


def load(x: Any, y: Any) -> Any:
    """Minus its Laplacian, the right-hand side."""
    value = w(x, y)
    return 2 * STEEP**2 * (1 + SLANT**2) * value * (1 - value**2)
