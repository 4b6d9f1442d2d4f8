"""u as a function of x and y from values at the nodes of a mesh of a domain."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.fields.on_domain import recover, reference_on
from solver.fields.bent_meshes import smooth_mesh

SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(-1.0, 2.0), y=(3.0, 3.5)), SECTOR])
def test_the_mesh_of_the_square_is_found_from_that_of_the_domain(domain: em.Domain) -> None:
    square = smooth_mesh(12)
    found = reference_on(map_mesh(square, domain), domain)
    assert found.distance(square) < 1e-12
    assert {*found.x[0]} | {*found.y[:, 0]} == {0.0}


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0)), SECTOR])
def test_the_function_has_the_values_at_the_nodes(domain: em.Domain) -> None:
    square = smooth_mesh(17)
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    values = np.sin(mesh.x) * mesh.y
    found = recover(mesh, values, domain)
    assert found.u.evaluate(mesh.x, mesh.y)[0] == pytest.approx(values, abs=1e-9)
    assert found.values == pytest.approx(values, abs=0.0)
