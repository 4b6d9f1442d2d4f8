"""Arrays from outside: real and finite numbers, or a sentence."""

from __future__ import annotations

from typing import Any

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array


def real(values: Any, what: str) -> Array:
    """``values`` as an array of floats, a copy, since a solver may use its array again.

    Raises :class:`BadValues`, about ``what``, where they are no real numbers, or masked.
    """
    if values is None:
        raise BadValues(f"{what} is None: a solver has to return its values")
    try:
        if np.ma.is_masked(values):
            raise BadValues(f"{what} has masked values: give a value at each place")
        found = np.asarray(values)
        if found.dtype.kind in "biuf":
            return np.array(found, dtype=np.float64)
        if found.dtype.kind != "c":
            raise TypeError(f"values of the type {found.dtype}")
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, BadValues):
            raise
        kind = f"{type(values).__module__}.{type(values).__qualname__}"
        raise BadValues(f"{what} is a {kind}, which is no array of numbers: give numbers in an array") from error
    raise BadValues(f"{what} has complex numbers: give real ones, such as their absolute values")


DIVERGED = "so the solver diverged: look at its messages and its boundary conditions"
"""What is wrong with a solution that is not finite."""


def finite(values: Array, what: str, remedy: str = DIVERGED) -> Array:
    """The ``values`` themselves. Raises :class:`BadValues`, about ``what``, where some are nan or infinite."""
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise BadValues(f"{what} has {bad} of {values.size} values that are nan or infinite, {remedy}")
    return values
