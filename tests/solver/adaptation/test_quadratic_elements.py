"""Solve, adapt, solve with elements of degree 2, whose solution alone is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

import equimesh as em
from equimesh.testing.geometries import l_shape
from equimesh_coupling import BadValues, element_points

PEAK, RING = "exp(-300*((x-0.5)**2 + (y-0.5)**2))", "atan(30*(hypot(x-0.5, y-0.5) - 0.25))"
HILL, ROOT = "2**40*(x*(1-x)*y*(1-y))**10", "(x + 1e-12)**0.6"


class Poisson:
    """A solver of ``-Lap u = f`` by biquadratic elements of scikit-fem, and the error of the gradient of each solve."""

    def __init__(self, text: str) -> None:
        self.u, self.errors = em.Expression(text), list[float]()

    def __call__(self, mesh: em.Mesh) -> tuple[Any, Any]:
        basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad2(), intorder=6)
        at = basis.global_coordinates()
        slopes = self.u.evaluate(at[0], at[1], 1)[1:]
        stiffness = skfem.BilinearForm(lambda v, w, _: dot(grad(v), grad(w))).assemble(basis)
        load = skfem.LinearForm(lambda v, p: p.s * grad(v)[0] + p.t * grad(v)[1])
        given = self.u.evaluate(*basis.doflocs)[0]
        sides = basis.get_dofs().flatten()
        solved = skfem.condense(stiffness, load.assemble(basis, s=slopes[0], t=slopes[1]), x=given, D=sides)
        vector = skfem.solve(*solved)
        found = np.asarray(basis.interpolate(vector).grad)
        self.errors.append(
            float(np.sqrt((sum((a - b) ** 2 for a, b in zip(found, slopes, strict=True)) * basis.dx).sum()))
        )
        return basis, vector


@pytest.mark.parametrize(("text", "least"), [(PEAK, 6.0), (RING, 2.5), (HILL, 1.3), (ROOT, 1.3)])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_quadratic_elements_of_scikit_fem_gain_and_never_lose(text: str, least: float, norm: Any) -> None:
    solver = Poisson(text)
    found = em.adapt(solver, 17, norm=norm, rounds=3)
    assert found.values.shape == (33, 33)  # the degree is that of the basis
    assert solver.errors[0] > least * solver.errors[found.best]


def exact(u: em.Field) -> Callable[[em.Mesh], np.ndarray]:
    """A solver that is exact at all nodes of its elements."""
    return lambda mesh: u.evaluate(*element_points(mesh, 2).T)[0]


def test_flat_values_need_the_degree() -> None:
    u = em.Expression("tanh(8*(x + y - 1))")
    found = em.adapt(exact(u), 9, degree=2, rounds=1)
    assert found.rounds[1].estimate < 0.7 * found.rounds[0].estimate
    with pytest.raises(BadValues, match="needs one value for each of the 81 nodes"):
        em.adapt(exact(u), 9, rounds=1)
    with pytest.raises(BadValues, match=r"elements of degree 2 have 289 nodes on this mesh: return an array of shape"):
        em.adapt(lambda mesh: mesh.x, 9, degree=2)
    with pytest.raises(em.InputError, match="degree = 3: give 1 or 2"):
        em.adapt(exact(u), 9, degree=3)


def test_blocks_adapt_to_quadratic_elements() -> None:
    domain, u = l_shape(300), em.Expression("tanh(15*(x + y - 1))")
    found = em.adapt(exact(u), domain=domain, degree=2, rounds=1)
    assert found.rounds[1].estimate < 0.8 * found.rounds[0].estimate
    assert not found.mesh.is_folded


def test_cells_thinner_than_the_bend_of_their_side_are_refused_with_the_remedy() -> None:
    u = em.Expression("x*x + y")
    with pytest.raises(em.InputError, match="take more cells along this side, or elements of degree 1") as error:
        em.adapt(exact(u), 5, domain=em.AnnulusSector(closed=True), degree=2)
    assert error.value.field == "mesh"
