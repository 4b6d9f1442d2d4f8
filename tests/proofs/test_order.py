"""MeshInput: node positions converge at second order in the spacing, for every boundary condition."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em

SIZES = (17, 33, 65)
REFERENCE = 129
BELL = "exp(-8*((x - 0.4)**2 + (y - 0.6)**2))"
# Right angles at the sides suit only a function with zero normal derivative there; the solution is not smooth else.
EVEN = "cos(pi*x) * cos(pi*y)"
# A bound on the finest error stands next to the order, so that neither can hide the other.
CASES = [
    (em.Boundary.TRACE, BELL, 1.2e-4),
    (em.Boundary.EQUIDISTRIBUTED_1D, BELL, 1.2e-4),
    (em.Boundary.ORTHOGONAL, EVEN, 8e-5),
]


@pytest.mark.parametrize(("boundary", "u", "largest"), CASES, ids=[str(case[0]) for case in CASES])
def test_second_order(boundary: em.Boundary, u: str, largest: float) -> None:
    monitor = em.ArcLength(u=em.Expression(u))
    meshes = {
        n: em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n), boundary=boundary)).mesh
        for n in (*SIZES, REFERENCE)
    }
    errors = []
    for n in SIZES:
        shared = slice(None, None, (REFERENCE - 1) // (n - 1))
        fine = meshes[REFERENCE]
        errors.append(
            max(abs(meshes[n].x - fine.x[shared, shared]).max(), abs(meshes[n].y - fine.y[shared, shared]).max())
        )
    # The reference has an error of its own: against it an error C h^2 shows as C (h^2 - h_reference^2).
    seen = [1 / (n - 1) ** 2 - 1 / (REFERENCE - 1) ** 2 for n in SIZES]
    orders = 2 * np.diff(np.log(errors)) / np.diff(np.log(seen))
    assert all(1.9 < order < 2.1 for order in orders), (orders, errors)
    assert errors[-1] < largest, errors
