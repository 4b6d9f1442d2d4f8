"""Arrays from outside: real and finite numbers, or a sentence."""

from __future__ import annotations

from typing import Any

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array


def real(values: Any, what: str) -> Array:
    """``values`` as an array of floats. Raises :class:`BadValues`, about ``what``, where they are no real numbers."""
    if values is None:
        raise BadValues(f"{what} is None: a solver has to return its values")
    try:
        found = np.asarray(values)
        if not np.iscomplexobj(found):
            return np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        kind = f"{type(values).__module__}.{type(values).__qualname__}"
        raise BadValues(f"{what} is a {kind}, which is no array of numbers: give numbers in an array") from error
    raise BadValues(f"{what} has complex numbers: give real ones, such as their absolute values")


def finite(values: Array, what: str) -> Array:
    """The ``values`` themselves. Raises :class:`BadValues`, about ``what``, where some are nan or infinite."""
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        raise BadValues(
            f"{what} has {bad} of {values.size} values that are nan or infinite, so the solver diverged: "
            "look at its messages and its boundary conditions"
        )
    return values
