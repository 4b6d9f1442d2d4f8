"""The objective for a goal: products of two errors, with their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.other_errors import DualField, DualObjective, objective_of
from equimesh.least_error.starts import coordinates_of

U, Z = em.Expression("sin(3*x)*exp(y)"), em.Expression("cos(4*y) + x**3")


def objective(u: em.Field, norm: Norm) -> Objective:
    first, weights = coordinates_of(em.Mesh.uniform(em.Grid(6))), Weights(distortion=0.1, smoothness=0.01)
    rule = Rule(norm=norm, points=3)
    return objective_of(u)(u, DomainChart(em.Rectangle()), cells_of_grid((6, 6)), first, weights, rule)


def meshes(of: Objective) -> tuple[np.ndarray, np.ndarray]:
    """A mesh with uneven cells, and a direction."""
    random = np.random.default_rng(3)
    return of.start + 0.02 * random.normal(size=of.start.shape) * of.cells.free, random.normal(
        size=of.start.shape
    ) * of.cells.free


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_gradient_is_that_of_the_products(norm: Norm) -> None:
    of = objective(DualField(u=U, adjoint=Z), norm)
    mesh, direction = meshes(of)
    values = [of.evaluate(mesh + step * direction) for step in (-1e-5, 0.0, 1e-5)]
    before, here, after = (one for one in values if one is not None)
    slope = float((here.gradient * direction).sum())
    assert (after.value - before.value) / 2e-5 == pytest.approx(slope, rel=1e-5)
    assert abs(slope) > 1e-2


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_function_that_is_its_own_adjoint_has_its_own_error(norm: Norm) -> None:
    both, alone = objective(DualField(u=U, adjoint=U), norm), objective(U, norm)
    assert isinstance(both, DualObjective)
    mesh, _ = meshes(both)
    one, other = both.evaluate(mesh), alone.evaluate(mesh)
    assert one.error == pytest.approx(other.error, rel=1e-9)
    assert np.allclose(one.gradient, other.gradient, rtol=1e-7, atol=1e-9)
    assert np.allclose(one.blocks, other.blocks, rtol=1e-7, atol=1e-9)


def test_the_error_of_a_product_is_at_most_that_of_both() -> None:
    errors = [objective(u, "h1") for u in (DualField(u=U, adjoint=Z), U, Z)]
    mesh, _ = meshes(errors[0])
    both, of_u, of_z = (one.error(mesh) for one in errors)
    assert 0.2 * of_u * of_z < both**2 < of_u * of_z


def test_where_one_of_both_is_known_exactly_there_is_no_error() -> None:
    of = objective(DualField(u=U, adjoint=em.Expression("2")), "h1")
    assert of.error(meshes(of)[0]) == 0.0
    assert of.evaluate(of.start) is None


def test_values_that_are_not_finite_are_refused() -> None:
    assert (
        objective(DualField(u=U, adjoint=em.Expression("1/(x - x)")), "h1").error(meshes(objective(U, "h1"))[0])
        == np.inf
    )
