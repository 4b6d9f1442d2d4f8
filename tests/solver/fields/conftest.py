"""A mesh that is adapted to a front."""

from __future__ import annotations

import pytest

import equimesh as em


@pytest.fixture(scope="module")
def front() -> em.Mesh:
    u = em.Expression("tanh(40*(x + y/2 - 0.75))")
    return em.solve(em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))).mesh
