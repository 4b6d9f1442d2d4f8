"""u from nodal values, and the estimate of the error on its own mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.least_error.kernels import Rule
from equimesh.rounds.recovery import Recovery, measured, moved_cells
from solver.fields.bent_meshes import smooth_mesh

FRONT = em.Expression("tanh(8*(x + y/2 - 0.75))")
SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0)), SECTOR])
def test_the_estimate_is_the_error_where_the_mesh_resolves_u(domain: em.Domain, norm: str) -> None:
    square = smooth_mesh(33)
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    known = Recovery.of(mesh, FRONT.evaluate(mesh.x, mesh.y)[0], domain)
    exact = measured(FRONT, domain, known.mesh, Rule(norm=norm))
    assert 0.8 < known.estimate(norm) / exact < 1.3


def test_the_estimate_of_a_linear_function_is_rounding() -> None:
    mesh = smooth_mesh(17)
    known = Recovery.of(mesh, 3.0 * mesh.x - mesh.y, UNIT_SQUARE)
    assert known.estimate("l2") < 1e-13


def test_moves_are_measured_in_spacings() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=9))
    assert moved_cells(mesh, em.Mesh(mesh.x + 0.25, mesh.y)) == pytest.approx(1.0)
    assert moved_cells(mesh, em.Mesh(mesh.x, mesh.y + 0.25)) == pytest.approx(2.0)
    assert moved_cells(mesh, mesh) == 0.0
    assert np.isfinite(moved_cells(mesh, em.Mesh(mesh.x * 0.5, mesh.y)))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0), y=(1.0, 1.5)), SECTOR])
def test_the_norm_of_the_gradient_is_that_of_a_linear_function(domain: em.Domain) -> None:
    mesh = map_mesh(em.Mesh.uniform(em.Grid(n_xi=33, n_eta=40)), domain)
    known = Recovery.of(mesh, 3.0 * mesh.x - 4.0 * mesh.y, domain)
    assert known.gradient_norm() == pytest.approx(5.0 * np.sqrt(domain.area), rel=1e-3)
