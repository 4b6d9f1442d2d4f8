"""The request for the next mesh of a solver."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import equimesh as em

NODES = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
VALUES = np.tanh(5.0 * (NODES.x - NODES.y))
NODAL = em.NodalField(mesh=NODES, values=VALUES)


def test_a_bound_one_measures_the_recovered_solution_and_knows_its_nodes() -> None:
    bound = em.NodalSolution(u=NODAL).on(em.Rectangle())
    assert bound.u is not NODAL
    assert bound.u.evaluate(NODES.x, NODES.y)[0] == pytest.approx(VALUES, abs=1e-12)
    assert bound.nodal is NODAL
    assert bound.on(em.Rectangle()) is bound
    wider = bound.on(em.Rectangle(x=(0.0, 1.0), y=(0.0, 1.0)))
    assert wider.nodal is NODAL
    assert pickle.loads(pickle.dumps(bound)).metric(0.5, 0.5)[0] == bound.metric(0.5, 0.5)[0]


def test_equal_requests_are_equal() -> None:
    one, other = em.NodalSolution(u=NODAL), em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES.copy()))
    assert one == other == one.on(em.Rectangle())
    assert hash(one) == hash(other)
    assert one != em.NodalSolution(u=NODAL, norm="h1")
    assert one != em.NodalSolution(u=em.NodalField(mesh=NODES, values=VALUES + 1.0))
    assert one != "a round"


def test_what_is_refused() -> None:
    with pytest.raises(em.InputError, match="values of a solver at the nodes"):
        em.NodalSolution(u=em.Expression("x"))
    with pytest.raises(em.InputError, match="norm = 'l3'"):
        em.NodalSolution(u=NODAL, norm="l3")
    with pytest.raises(em.InputError, match=r"call monitor\.on"):
        em.NodalSolution(u=NODAL).metric(NODES.x, NODES.y)
    with pytest.raises(em.InputError, match="the grid has 17 x 17 points, the values are 9 x 9"):
        em.NodalSolution(u=NODAL).require_grid(em.Grid(n_xi=17, n_eta=17))
