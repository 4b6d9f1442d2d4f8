"""Adapting to a functional of the solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

import equimesh as em
from equimesh.testing.geometries import disc, l_shape
from equimesh_coupling.goals import goal_values

FRONT = em.Expression("tanh(25*(x - 0.3)) + tanh(25*(y - 0.6))")
PLACE = (0.35, 0.62)


def source(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The right side of Poisson's equation for the front."""
    found = FRONT.evaluate(x, y, order=2)
    return -(found[3] + found[5])


POINT = em.Goal.point(*PLACE, diffusion=1.0, source=source)


def bump(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.exp(-((x - PLACE[0]) ** 2 + (y - PLACE[1]) ** 2) / 0.02)


def mean_near_the_crossing(mesh: em.Mesh) -> np.ndarray:
    """The weights of an integral with a smooth weight."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=6)
    weights: np.ndarray = skfem.LinearForm(lambda v, w: bump(*w.x) * v).assemble(basis)
    return weights


MEAN = em.Goal(mean_near_the_crossing, diffusion=1.0)


def parts(mesh: em.Mesh) -> dict[str, Any]:
    """Bilinear elements for Poisson's equation whose solution is the front."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=6)
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    _, x, y = FRONT.evaluate(*basis.global_coordinates(), order=1)
    load = skfem.LinearForm(lambda v, w: w.slope_x * grad(v)[0] + w.slope_y * grad(v)[1])
    right, fixed = load.assemble(basis, slope_x=x, slope_y=y), basis.get_dofs().all()
    known = FRONT.evaluate(*mesh.points.T)[0]
    return {"u": skfem.solve(*skfem.condense(matrix, right, x=known, D=fixed)), "matrix": matrix, "fixed": fixed}


def with_matrix(mesh: em.Mesh) -> em.WithAdjoint:
    return em.WithAdjoint(**parts(mesh))


def with_adjoint(mesh: em.Mesh) -> em.WithAdjoint:
    known = parts(mesh)
    z = skfem.solve(*skfem.condense(known["matrix"].T, POINT.on(mesh), D=known["fixed"]))
    return em.WithAdjoint(known["u"], z, fixed=known["fixed"])


def test_the_mesh_serves_the_functional_and_its_error_is_known() -> None:
    found = em.adapt(with_matrix, 25, goal=MEAN, rounds=1)
    first = found.rounds[0].goal
    fine = em.Mesh.uniform(em.Grid(257))
    exact = float(MEAN.on(fine) @ FRONT.evaluate(*fine.points.T)[0])
    assert abs(exact - found.goal.value) < 0.3 * abs(exact - first.value)
    assert abs(exact - found.goal.corrected) < 0.5 * abs(exact - found.goal.value)
    assert found.goal.bound < 0.4 * first.bound
    assert found.mesh.min_jacobian > 0.0
    assert found.rounds[1].adjoint is not None
    assert {"value", "error", "corrected", "bound"} <= set(found.rounds[1].numbers())
    assert "functional" in found._repr_html_()


def test_the_error_of_a_value_at_a_point_is_that_of_a_solution_of_degree_2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.FRONT", em.Expression("sin(3*x)*exp(2*y)"))
    exact = float(FRONT.evaluate(*np.array(PLACE)[:, None])[0][0])
    for one in em.adapt(with_matrix, 13, goal=POINT, rounds=1).rounds:
        assert one.goal.error is not None
        assert 0.8 < one.goal.error / (exact - one.goal.value) < 1.25


def test_an_adjoint_of_the_solver_gives_the_mesh_of_its_matrix() -> None:
    one, other = (em.adapt(solve, 13, goal=POINT, rounds=1).rounds[1] for solve in (with_matrix, with_adjoint))
    assert one.mesh.distance(other.mesh) < 1e-9
    assert one.goal.value == pytest.approx(other.goal.value)


@pytest.mark.parametrize(
    ("side", "u", "source", "flux"),
    [
        ("left", lambda x, y: np.sin(np.pi * x) * np.sin(np.pi * y), None, -2.0),
        ("right", lambda x, y: x + y**2 + y * np.cos(2.0 * x), lambda x, y: 4.0 * y * np.cos(2.0 * x) - 2.0, None),
    ],
    ids=["none at the corners", "through the sides next to it, too"],
)
def test_a_flux_through_a_side_has_the_order_of_the_solution(side: str, u: Any, source: Any, flux: Any) -> None:
    def solve(mesh: em.Mesh) -> em.WithAdjoint:
        basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=5)
        matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
        load = skfem.LinearForm(lambda v, w: (source or (lambda x, y: 2.0 * np.pi**2 * u(x, y)))(*w.x) * v)
        right, fixed = load.assemble(basis), basis.get_dofs().all()
        known = u(*basis.doflocs)
        found = skfem.solve(*skfem.condense(matrix, right, x=known, D=fixed))
        return em.WithAdjoint(found, matrix=matrix, fixed=fixed, load=right)

    right = source or (lambda x, y: 2.0 * np.pi**2 * u(x, y))
    goal, exact = em.Goal.flux(side, diffusion=1.0, source=right), 1.0 - np.sin(2.0) if flux is None else flux
    errors = []
    for n in (9, 17):
        mesh = em.Mesh.uniform(em.Grid(n))
        found = goal_values(solve(mesh), mesh, goal)
        errors.append(exact - found.value)
        assert found.error == pytest.approx(errors[-1], rel=0.15, abs=5e-4)
    assert abs(errors[0]) > 3.0 * abs(errors[1])
    assert abs(errors[1]) < 0.02


def test_the_error_knows_that_a_side_is_round() -> None:
    mesh, goal = disc(200).mesh, em.Goal.point(0.2, 0.3, diffusion=1.0, source=1.0)
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1())
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    load, fixed = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(basis), basis.get_dofs().all()
    returned = em.WithAdjoint(skfem.solve(*skfem.condense(matrix, load, D=fixed)), matrix=matrix, fixed=fixed)
    found = goal_values(returned, mesh, goal)
    assert found.error == pytest.approx(0.25 * (1.0 - 0.13) - found.value, rel=0.05)


def test_the_loop_ends_at_the_tolerance() -> None:
    loose = em.adapt(with_matrix, 25, goal=POINT, tolerance=0.02)
    assert (len(loose.rounds), loose.best) == (2, 1)
    assert "within the tolerance of 0.02" in loose.reason
    assert loose.resolved


def test_an_adjoint_of_another_mesh_ends_the_loop_with_the_last_good_mesh() -> None:
    count = iter(range(9))

    def solve(mesh: em.Mesh) -> em.WithAdjoint:
        known = parts(mesh)
        return em.WithAdjoint(known["u"], known["u"][: -1 if next(count) else None], fixed=known["fixed"])

    found = em.adapt(solve, 9, goal=POINT)
    assert (len(found.rounds), found.best) == (1, 0)
    assert "the adjoint has the shape (80,)" in found.reason
    assert isinstance(found.failure, em.BadValues)


def test_on_blocks_the_bound_of_the_error_falls() -> None:
    domain, place = l_shape(300), (-0.4, 0.4)

    def solve(mesh: em.Mesh) -> em.WithAdjoint:
        basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1())
        matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
        load, fixed = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(basis), basis.get_dofs().all()
        return em.WithAdjoint(skfem.solve(*skfem.condense(matrix, load, D=fixed)), matrix=matrix, fixed=fixed)

    found = em.adapt(solve, domain=domain, goal=em.Goal.point(*place, diffusion=1.0), rounds=1)
    goals = [one.goal for one in found.rounds]
    assert goals[1].bound < 0.85 * goals[0].bound
    assert goals[1].error is None


@pytest.mark.parametrize(
    ("arguments", "field", "words"),
    [
        ({"goal": 1.0}, "goal", "give one, such as Goal.point"),
        ({"tolerance": 1e-3}, "tolerance", "give the goal, too"),
        ({"goal": POINT, "tolerance": -1.0}, "tolerance", "give a positive number"),
        ({"goal": POINT, "tolerance": "1e-3"}, "tolerance", "tolerance = '1e-3': give a positive number"),
        ({"goal": POINT, "degree": 2}, "degree", "degree = 2: an adjoint is known on elements of degree 1 alone"),
        ({"goal": POINT, "norm": "l2"}, "norm", "leave norm out"),
        ({"goal": POINT, "norm": "h1"}, "norm", "leave norm out"),
    ],
)
def test_arguments_that_cannot_be_used_are_a_sentence(arguments: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(em.InputError, match=words) as caught:
        em.adapt(with_matrix, 9, **arguments)
    assert caught.value.field == field


def test_a_number_of_points_is_refused_with_a_goal() -> None:
    with pytest.raises(em.InputError, match="give n with a goal"):
        em.adapt(with_matrix, points=100, goal=POINT)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("returned", "goal", "words"),
    [
        (lambda mesh: mesh.x, POINT, "with a goal, return WithAdjoint"),
        (lambda mesh: em.WithAdjoint(mesh.x, mesh.y), None, "an adjoint needs a goal"),
    ],
)
def test_goal_and_adjoint_belong_together(returned: Callable[[em.Mesh], Any], goal: em.Goal | None, words: str) -> None:
    with pytest.raises(em.BadValues, match=words):
        em.adapt(returned, 9, goal=goal)


def test_a_round_with_an_adjoint_lowers_the_products() -> None:
    mesh = em.Mesh.uniform(em.Grid(17))
    u = FRONT.evaluate(mesh.x, mesh.y)[0]
    found = em.adapt_round(mesh, u, adjoint=u)
    alone = em.adapt_round(mesh, u, norm="h1")
    assert found.mesh.distance(alone.mesh) < 1e-9
    assert found.products.bound == pytest.approx(found.estimate_h1**2)
    assert found.products.diffusion == pytest.approx(found.products.bound, rel=0.1)
    with pytest.raises(em.InputError, match="the functional is constant"):
        em.adapt_round(mesh, u, adjoint=0.0 * u)
    with pytest.raises(em.InputError, match="degree 1 alone"):
        em.adapt_round(mesh, np.zeros((33, 33)), degree=2, adjoint=u)
