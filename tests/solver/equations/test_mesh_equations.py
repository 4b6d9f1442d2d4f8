"""The discrete equations of a window: what solves them, and which conditions own which rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.boundary import sides
from equimesh.equations.mesh_equations import MeshEquations, NodalState, Rows


@dataclass(frozen=True)
class Held:
    """The x of one node, held at a value."""

    node: tuple[int, int]
    value: float

    def rows(self, window: NodalState) -> Rows:
        unknown = np.array([window.numbers[0][self.node]])
        return Rows(unknown, np.array([window.x[self.node] - self.value]), lambda: [(unknown, unknown, np.ones(1))])


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("cross_line", [0.0, 0.7])
def test_the_uniform_mesh_solves_the_equations_of_no_monitor(boundary: em.Boundary, cross_line: float) -> None:
    case = problem("ring", 9, 6, boundary=boundary, a=0.0)
    equations = case.equations(cross_line)
    z = equations.vector(em.Mesh.uniform(case.grid))
    assert abs(equations.residual(z)).max() < 1e-13
    assert equations.mean_flux(z) == pytest.approx(1.0)


def test_a_vector_is_x_and_then_y() -> None:
    case = problem("ring", 5, 4)
    mesh = em.solve(case).reference
    z = case.equations().vector(mesh)
    assert z.tolist() == [*mesh.x.ravel(), *mesh.y.ravel()]
    again = case.equations().mesh(z)
    assert np.array_equal(again.x, mesh.x)
    assert np.array_equal(again.y, mesh.y)
    again.x[:] = 7.0
    assert not (z == 7.0).any(), "a mesh owns its nodes"


def test_a_turned_window_turned_again_is_the_window() -> None:
    case = problem("ring", 6, 5, b=0.2)
    equations = case.equations()
    window = equations.window(equations.vector(em.Mesh.uniform(case.grid)))
    turned = window.turned()
    assert turned.x.shape == (5, 6)
    assert np.array_equal(turned.u_x, window.u_y.T)
    again = turned.turned()
    for name in ("x", "y", "u", "u_x", "u_y"):
        assert np.array_equal(getattr(again, name), getattr(window, name)), name
    assert (again.d_xi, again.d_eta, again.metric) == (window.d_xi, window.d_eta, window.metric)


def test_a_condition_takes_the_place_of_those_before_it() -> None:
    case = problem("ring", 6, 5)
    first, second = Held((2, 2), 5.0), Held((2, 2), 7.0)
    closed = [*sides(case.boundary).values(), first, second]
    equations = MeshEquations(case.metric, case.grid.shape, (case.grid.d_xi, case.grid.d_eta), closed)
    z = equations.vector(em.Mesh.uniform(case.grid))
    row = equations.numbers[0][2, 2]
    assert equations.residual(z)[row] == z[row] - 7.0
    derivative = equations.jacobian(z).tocsr()[[row]].toarray().ravel()
    assert np.flatnonzero(derivative).tolist() == [row], "nothing of the interior is left in the row"
    assert derivative[row] == 1.0


def test_an_edge_s_flux_goes_to_its_two_ends_with_opposite_signs() -> None:
    """Summed along a line the interior equations telescope: only the outermost edges are left."""
    case = problem("ring", 8, 5, b=0.1)
    equations = MeshEquations(case.metric, case.grid.shape, (case.grid.d_xi, case.grid.d_eta), [])
    uniform = em.Mesh.uniform(case.grid)
    z = equations.vector(em.Mesh(uniform.x + 0.02 * np.sin(5 * uniform.y), uniform.y + 0.03 * uniform.x**2))
    whole = equations.residual(z)[: equations.size].reshape(case.grid.shape)[1:-1, 1:-1].sum(axis=0)
    parts = []
    for rows in (slice(0, 3), slice(5, 8)):
        mesh = em.Mesh(equations.mesh(z).x[rows], equations.mesh(z).y[rows])
        part = MeshEquations(case.metric, (3, 5), (case.grid.d_xi, case.grid.d_eta), [])
        parts.append(part.residual(part.vector(mesh))[:15].reshape(3, 5)[1, 1:-1])
    middle = em.Mesh(equations.mesh(z).x[1:7], equations.mesh(z).y[1:7])
    inner = MeshEquations(case.metric, (6, 5), (case.grid.d_xi, case.grid.d_eta), [])
    inside = inner.residual(inner.vector(middle))[:30].reshape(6, 5)[1:-1, 1:-1].sum(axis=0)
    assert whole == pytest.approx(parts[0] + inside + parts[1])
