"""Functions of the reference square on the points of a domain."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.on_domain import Inverse, OnDomain
from equimesh.testing import check_field
from solver.bent import CURVED
from solver.fields.bent_meshes import ANYWHERE, largest

SECTOR = em.AnnulusSector(radii=(1.0, 3.0), angles=(10.0, 100.0))
DOMAINS = [em.Rectangle(x=(-1.0, 3.0), y=(2.0, 2.5)), SECTOR, CURVED]


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_inverse_gives_back_the_points_of_the_square(domain: em.Domain) -> None:
    assert largest(Inverse(domain=domain).at(*domain.map(*ANYWHERE)), tuple(ANYWHERE)).max() < 1e-12


def test_a_function_of_the_radius_is_one_of_s() -> None:
    field = OnDomain(reference=em.Expression("(1 + 2*x)**2"), domain=SECTOR)
    x, y = SECTOR.map(*ANYWHERE)
    exact = (x * x + y * y, 2.0 * x, 2.0 * y, np.full(500, 2.0), np.zeros(500), np.full(500, 2.0))
    assert largest(field.evaluate(x, y, order=2), exact).max() < 1e-8


def test_it_is_a_field() -> None:
    check_field(OnDomain(reference=em.Expression("sin(2*x)*exp(y)"), domain=SECTOR), ((1.0, 1.5), (1.0, 1.5)))


def test_points_outside_have_the_value_of_one_next_to_them() -> None:
    field = OnDomain(reference=em.Expression("x"), domain=SECTOR)
    assert abs(field.evaluate(np.array([0.7]), np.array([0.7]))[0]).max() < 1e-12
