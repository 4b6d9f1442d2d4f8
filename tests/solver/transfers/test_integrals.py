"""The integrals that are kept."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.transfers.integrals import cells_of, total
from solver.fields.bent_meshes import smooth_mesh
from solver.transfers.cases import averages


def test_the_integral_of_nodal_values_is_that_of_the_bilinear_function() -> None:
    skfem = pytest.importorskip("skfem")
    mesh = smooth_mesh(9)
    values = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.x.shape)
    basis = skfem.Basis(skfem.MeshQuad(mesh.points.T, mesh.cells.T), skfem.ElementQuad1())
    exact = skfem.Functional(lambda w: w["u"]).assemble(basis, u=basis.interpolate(values.reshape(-1)))
    assert em.integral(mesh, values) == pytest.approx(float(exact), abs=1e-14)


def test_areas_and_centroids_are_exact() -> None:
    cells = cells_of(smooth_mesh(9))
    for values, function in ((cells.x, lambda x, y: x + 0 * y), (cells.y, lambda x, y: y + 0 * x)):
        assert np.abs(values - averages(smooth_mesh(9), function).reshape(-1)).max() < 1e-15
    assert total(cells.area, np.ones(cells.area.size)) == pytest.approx(1.0, abs=1e-15)
    assert cells.node_weights.sum() == pytest.approx(1.0, abs=1e-14)
    assert np.all(cells.weights > 0.0)
    nodal = np.arange(9 * 12, dtype=float)
    assert cells.at_corners(nodal)[0].tolist() == [0.0, 12.0, 13.0, 1.0]


def test_values_of_another_shape_are_refused() -> None:
    assert em.integral(smooth_mesh(9), np.ones((8, 11)), "cells") == pytest.approx(1.0)
    with pytest.raises(SamplesError, match=r"\(9, 12\) is needed for nodes"):
        em.integral(smooth_mesh(9), np.ones((8, 11)))
