"""The error of a cell-centred code, against those of OpenFOAM 1912."""

from __future__ import annotations

import math

import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.quality.faces import poisson_error
from solver.quality.test_faces import waves

U = em.Expression("exp(x)*sin(3*y) + tanh(4*(x - y))")


@pytest.mark.parametrize(
    ("mesh", "error"),
    [
        (waves((17, 13), em.Rectangle()), 0.024984034231097636),
        (waves((9, 25), em.AnnulusSector()), 0.1878909067826689),
    ],
)
def test_the_error_of_open_foam(mesh: Mesh, error: float) -> None:
    """``Gauss linear corrected`` with 120 corrections gave these, with u at the middles of the faces of the sides."""
    assert poisson_error(mesh, U) == pytest.approx(error, rel=1e-9)


def test_the_error_on_uniform_meshes_is_of_second_order() -> None:
    errors = [poisson_error(Mesh.uniform(em.Grid(n_xi=n, n_eta=n)), U) for n in (17, 33, 65)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.03)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.01)
    assert errors[2] < 5e-4


def test_what_is_linear_has_no_error_on_an_orthogonal_mesh() -> None:
    assert poisson_error(Mesh.uniform(em.Grid(n_xi=9, n_eta=7)), em.Expression("3*x - y + 2")) < 1e-13


def test_a_folded_mesh_and_a_source_that_is_not_finite_have_none() -> None:
    uniform = Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    assert poisson_error(uniform, em.Expression("log((x - 0.375)**2 + (y - 0.375)**2)")) == math.inf
    folded = Mesh(uniform.x.copy(), uniform.y)
    folded.x[1, 1] = 0.9
    assert poisson_error(folded, U) == math.inf
