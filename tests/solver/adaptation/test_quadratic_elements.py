"""Solve, adapt, solve with elements of degree 2 to 4, whose solution alone is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.least_error.kernels import Rule
from equimesh.rounds.norms import measured
from equimesh_coupling import BadValues, element_points

PEAK, RING = "exp(-300*((x-0.5)**2 + (y-0.5)**2))", "atan(30*(hypot(x-0.5, y-0.5) - 0.25))"
HILL, ROOT = "2**40*(x*(1-x)*y*(1-y))**10", "(x + 1e-12)**0.6"
LAYER = "tanh(15*(x + y/2 - 0.75))"


class Poisson:
    """A solver of ``-Lap u = f`` by elements of degree 2 of scikit-fem, and the error of the gradient of each solve."""

    def __init__(self, text: str, cells: Any = "quad") -> None:
        self.u, self.cells, self.errors = em.Expression(text), cells, list[float]()

    def __call__(self, mesh: em.Mesh) -> tuple[Any, Any]:
        element = skfem.ElementQuad2() if self.cells == "quad" else skfem.ElementTriP2()
        basis = skfem.Basis(mesh.to_skfem(cells=self.cells), element, intorder=6)
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


@pytest.mark.parametrize(
    ("text", "norm", "least"),
    [(PEAK, "l2", 6.0), (RING, "l2", 2.5), (HILL, "l2", 1.3), (ROOT, "l2", 1.3), (PEAK, "h1", 6.0), (ROOT, "h1", 1.3)],
)
def test_quadratic_elements_of_scikit_fem_gain_and_never_lose(text: str, norm: Any, least: float) -> None:
    solver = Poisson(text)
    found = em.adapt(solver, 17, norm=norm, rounds=3)
    assert found.values.shape == (33, 33)  # the degree is that of the basis
    assert solver.errors[0] > least * solver.errors[found.best]


@pytest.mark.parametrize(("text", "norm", "gain"), [(HILL, "h1", 2.0), (LAYER, "h1", 8.0)])
def test_quadratic_triangles_gain_more_than_by_bilinear_rounds(text: str, norm: Any, gain: float) -> None:
    solver, untold = Poisson(text, "triangle"), Poisson(text, "triangle")
    found = em.adapt(solver, 17, norm=norm, rounds=2)  # the cells and the degree are those of the basis
    assert found.values.shape == (33, 33)
    plain = em.adapt(untold, 17, norm=norm, rounds=2, degree=1)
    assert solver.errors[0] > gain * solver.errors[found.best]
    assert untold.errors[plain.best] > 1.5 * solver.errors[found.best]
    for record, error in zip(found.rounds, solver.errors, strict=True):
        assert 0.8 < (record.estimate_h1 or 0.0) / error < 1.6


def exact(u: em.Field, degree: int = 2, cells: Any = "quad") -> Callable[[em.Mesh], np.ndarray]:
    """A solver that is exact at all nodes of its elements."""
    return lambda mesh: u.evaluate(*element_points(mesh, degree, cells).T)[0]


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_values_at_the_nodes_of_elements_adapt_the_mesh_and_need_the_degree(degree: int) -> None:
    u, nodes = em.Expression("exp(-8*x) + y*y"), (8 * degree + 1) ** 2
    found = em.adapt(exact(u, degree), 9, degree=degree, rounds=1)
    assert found.rounds[1].estimate < 0.3 * found.rounds[0].estimate
    with pytest.raises(BadValues, match="needs one value for each of the 81 nodes"):
        em.adapt(exact(u, degree), 9, rounds=1)
    with pytest.raises(BadValues, match=rf"elements of degree {degree} have {nodes} nodes on this mesh: return an"):
        em.adapt(lambda mesh: mesh.x, 9, degree=degree)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"degree": 5}, "degree = 5: give 1 to 4"),
        ({"degree": 3, "cells": "triangle"}, "degree = 3: on triangles elements have degree 1 or 2"),
        ({"cells": "hexagon"}, "cells = 'hexagon': choose 'quad' or 'triangle'"),
        ({"cells": "triangle", "goal": em.Goal.point(0.5, 0.5)}, "with an adjoint errors are those on quadrilaterals"),
    ],
)
def test_elements_that_no_round_knows_are_refused(given: Any, sentence: str) -> None:
    with pytest.raises(em.InputError, match=sentence):
        em.adapt(exact(em.Expression("x*y")), 9, **given)


def test_linear_triangles_are_told_by_the_cells_alone() -> None:
    """Across the diagonals of the cells, linear elements err more than bilinear ones, and the mesh is another one."""
    u = em.Expression("exp(-40*(x - y)**2)")
    found = {cells: em.adapt(exact(u, 1), 9, cells=cells, rounds=1) for cells in ("quad", "triangle")}
    quad, triangle = (one.rounds[0].estimate_h1 or 0.0 for one in found.values())
    error = measured(u, em.Rectangle(), em.Mesh.uniform(em.Grid(9)), Rule(norm="h1", cells="triangle", points=4))
    assert abs(triangle - error) < abs(quad - error)
    assert found["quad"].rounds[1].mesh.distance(found["triangle"].rounds[1].mesh) > 0.0


HALVES = em.Blocks.of({
    "vertices": {f"{x}{y}": [x / 2, y] for x in range(3) for y in range(2)},
    "blocks": [{"corners": [f"{x}0", f"{x + 1}0", f"{x + 1}1", f"{x}1"], "cells": [8, 16]} for x in range(2)],
})  # fmt: skip


@pytest.mark.parametrize(
    ("degree", "cells", "gain"), [(2, "quad", 3.0), (3, "quad", 3.0), (4, "quad", 3.0), (2, "triangle", 8.0)]
)
def test_blocks_adapt_to_elements_of_higher_degree(degree: int, cells: Any, gain: float) -> None:
    u, rule = em.Expression("tanh(15*(x + y - 1))"), Rule(norm="l2", cells=cells, points=degree + 2, degree=degree)
    found = em.adapt(exact(u, degree, cells), domain=HALVES, degree=degree, cells=cells, rounds=1)
    before, after = (measured(u, HALVES, one.mesh, rule) for one in found.rounds)
    assert before > gain * after
    assert not found.mesh.is_folded


@pytest.mark.parametrize(("degree", "cells"), [(2, "quad"), (3, "quad"), (2, "triangle")])
def test_cells_may_be_thinner_than_the_bend_of_their_side(degree: int, cells: Any) -> None:
    u, domain = em.Expression("exp(x)*y"), em.AnnulusSector(closed=True)
    found = em.adapt(exact(u, degree, cells), 7, domain=domain, degree=degree, cells=cells, rounds=1)
    grid = em.Grid(n_xi=7, n_eta=7)
    uniform = measured(u, domain, em.Mesh.uniform(grid), Rule(norm="l2", cells=cells, points=5, degree=degree))
    assert found.rounds[0].estimate == pytest.approx(uniform, rel=0.3)
    assert found.rounds[1].estimate < 0.6 * found.rounds[0].estimate
    assert not found.mesh.is_folded


@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_the_estimate_of_quadratic_elements_holds_next_to_curved_sides(cells: Any) -> None:
    u, domain, grid = em.Expression("exp(x)*y"), em.AnnulusSector(), em.Grid(7)
    mesh = map_mesh(em.Mesh.uniform(grid), domain)
    found = em.adapt_round(mesh, exact(u, 2, cells)(mesh).reshape(13, 13), domain, degree=2, cells=cells)
    for norm, estimate in (("l2", found.estimate), ("h1", found.estimate_h1)):
        rule = Rule(norm=norm, cells=cells, points=4, degree=2)  # type: ignore[arg-type]
        assert estimate == pytest.approx(measured(u, domain, em.Mesh.uniform(grid), rule), rel=0.1)
