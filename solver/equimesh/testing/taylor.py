"""Taylor remainders: the check of a derivative."""

from collections.abc import Callable

import numpy as np

from equimesh.numerics.types import Array

STEP = 1e-4  # the larger step, in units of the size of the problem
ACCURACY = 1e-6  # of a derivative, as a share of its scale


def wrong_by(value: Callable[[float], Array], slope: Array, size: float = 1.0) -> Array:
    """The distance of ``slope`` from the derivative of ``value`` at 0, entry by entry; 0 where the two agree.

    Their difference is ``r(h) / h``, with ``r(h) = (value(h) - value(-h)) / 2 - h slope`` the odd part of the Taylor
    remainder. It falls at second order in h to the error of the slope. Two values of h, ``STEP * size`` and half of it,
    show how large the part is that falls. Only an excess over that part is reported, so that no error is reported for a
    steep function, or one with a kink near a point.
    """
    coarse, fine = ((value(h) - value(-h)) / (2.0 * h) - slope for h in (STEP * size, 0.5 * STEP * size))
    scale = np.abs(slope).max(initial=0.0) + np.abs(value(0.0)).max(initial=0.0) / size
    error = np.abs(fine - (coarse - fine) / 3.0)
    return np.where(error > np.abs(coarse - fine) + ACCURACY * scale, error, 0.0)
