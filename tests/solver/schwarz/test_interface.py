"""Interfaces as rows: functional minus received value, on the nodes that belong to the interface."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import NodalState
from equimesh.schwarz.functionals import Interface, InterfaceCorner, InterfaceData

CASE = problem("ring", 6, 5)


def window() -> NodalState:
    equations, uniform = CASE.equations(), em.Mesh.uniform(CASE.grid)
    return equations.window(equations.vector(em.Mesh(uniform.x + 0.1 * uniform.y**2, uniform.y + 0.05 * uniform.x)))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("end", [0, 1])
def test_classical_rows_are_differences_of_positions(axis: int, end: int) -> None:
    state = window()
    x, y = (state.x, state.y) if axis == 0 else (state.y.T, state.x.T)
    rim, nodes, free = -1 if end else 0, slice(1, 4), slice(1, 3)
    normal, tangential = np.array([0.3, 0.1, 0.2]), np.array([0.5, 0.6, 0.7])
    interface = Interface(
        condition=em.Classical(),
        axis=axis,
        end=end,
        line=x.shape[0] - 1 if end else 0,
        nodes=nodes,
        free=free,
        p=0.0,
        data=InterfaceData(normal=normal, tangential=tangential),
    )
    found = interface.rows(state)
    expected = [*(x[rim, nodes] - normal), *(y[rim, free] - tangential[:2])]
    assert found.values == pytest.approx(np.array(expected))
    numbers = state.numbers if axis == 0 else (state.numbers[1].T, state.numbers[0].T)
    assert found.rows.tolist() == [*numbers[0][rim, nodes], *numbers[1][rim, free]]
    for rows, columns, values in found.triplets():
        assert np.array_equal(rows, columns)
        assert (values == 1.0).all()


def test_a_corner_holds_both_coordinates() -> None:
    state = window()
    found = InterfaceCorner(node=(5, 0), x=0.9, y=0.2).rows(state)
    assert found.values.tolist() == [state.x[5, 0] - 0.9, state.y[5, 0] - 0.2]
    assert found.rows.tolist() == [state.numbers[0][5, 0], state.numbers[1][5, 0]]
