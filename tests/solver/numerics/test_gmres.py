"""GMRES: exact after as many products as unknowns, smaller residuals with every product, honest where it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.numerics.newton import dot, gmres
from equimesh.numerics.types import Array

SIZE = 12


def system() -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    return np.eye(SIZE) * 3.0 + rng.standard_normal((SIZE, SIZE)), rng.standard_normal(SIZE)


def same(v: Array) -> Array:
    return v.copy()


def test_it_is_exact_after_as_many_products_as_unknowns() -> None:
    matrix, right = system()
    found = gmres(lambda v: matrix @ v, same, right, tolerance=1e-14, most=SIZE)
    assert found == pytest.approx(np.linalg.solve(matrix, right), rel=1e-10)


def test_every_product_lowers_the_residual_to_its_smallest() -> None:
    matrix, right = system()
    for most in (1, 3, 6):
        found = gmres(lambda v: matrix @ v, same, right, tolerance=0.0, most=most)
        space = np.column_stack([np.linalg.matrix_power(matrix, k) @ right for k in range(most)])
        best, *_ = np.linalg.lstsq(matrix @ space, right, rcond=None)
        smallest = np.linalg.norm(matrix @ space @ best - right)
        assert np.linalg.norm(matrix @ found - right) == pytest.approx(smallest, rel=1e-8)


def test_an_exact_preconditioner_needs_one_product() -> None:
    matrix, right = system()
    products: list[Array] = []

    def apply(v: Array) -> Array:
        products.append(v)
        return np.asarray(matrix @ v)

    found = gmres(apply, lambda v: np.linalg.solve(matrix, v), right, tolerance=1e-10, most=SIZE)
    assert len(products) == 1
    assert matrix @ found == pytest.approx(right, rel=1e-10)


def test_it_ends_at_the_tolerance() -> None:
    matrix, right = system()
    found = gmres(lambda v: matrix @ v, same, right, tolerance=0.1, most=SIZE)
    rest = np.linalg.norm(matrix @ found - right) / np.linalg.norm(right)
    assert 1e-3 < rest <= 0.1


@pytest.mark.parametrize("right", [np.zeros(3), np.array([1.0, np.nan, 0.0])])
def test_without_a_finite_right_side_nothing_changes(right: Array) -> None:
    assert (gmres(same, same, right, tolerance=1e-3, most=3) == 0.0).all()


def test_a_product_that_is_not_finite_ends_it() -> None:
    found = gmres(lambda v: np.full(v.size, np.inf), same, np.ones(3), tolerance=1e-3, most=3)
    assert (found == 0.0).all()


@pytest.mark.parametrize("size", [0, 1, 4, 7])
def test_the_inner_product(size: int) -> None:
    first, second = np.arange(size) + 1.0, 2.0 * np.arange(size)
    assert dot(first, second) == pytest.approx(float(first @ second))
