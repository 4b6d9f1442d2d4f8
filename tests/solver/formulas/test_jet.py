"""Jets: parts that vanish by structure cost nothing."""

from __future__ import annotations

import numpy as np

from equimesh.formulas.jet import OPERATIONS, constant, coordinates


def test_structural_zeros_cost_nothing() -> None:
    x, y = coordinates(np.array([0.5]), np.array([0.25]))
    u = OPERATIONS["sin"](OPERATIONS["*"](constant(15.0), x, 2), 2)
    assert u.gradient[1] is None
    assert u.hessian[1:] == (None, None)
    assert OPERATIONS["*"](constant(15.0), x, 2).gradient[0] == 15.0
    assert OPERATIONS["*"](x, y, 2).hessian == (None, 1.0, None)
