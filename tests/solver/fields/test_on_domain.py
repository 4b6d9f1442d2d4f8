"""Functions of the reference square on the points of a domain."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.fields.on_domain import Inverse, OnDomain, recover, reference_on
from equimesh.testing import check_field
from solver.bent import CURVED
from solver.fields.bent_meshes import ANYWHERE, largest, smooth_mesh

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


# u as a function of x and y from values at the nodes of a mesh of a domain.


NARROW_SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(-1.0, 2.0), y=(3.0, 3.5)), NARROW_SECTOR])
def test_the_mesh_of_the_square_is_found_from_that_of_the_domain(domain: em.Domain) -> None:
    square = smooth_mesh(12)
    found = reference_on(map_mesh(square, domain), domain)
    assert found.distance(square) < 1e-12
    assert {*found.x[0]} | {*found.y[:, 0]} == {0.0}


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0)), NARROW_SECTOR])
def test_the_function_has_the_values_at_the_nodes(domain: em.Domain) -> None:
    square = smooth_mesh(17)
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    values = np.sin(mesh.x) * mesh.y
    found = recover(mesh, values, domain)
    assert found.u.evaluate(mesh.x, mesh.y)[0] == pytest.approx(values, abs=1e-9)
    assert found.values == pytest.approx(values, abs=0.0)
