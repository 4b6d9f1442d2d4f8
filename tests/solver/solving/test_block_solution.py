"""The result of a solve on blocks: what it says of itself, next to the initial mesh."""

from __future__ import annotations

import json

import numpy as np
import pytest

import equimesh as em
from equimesh.testing.geometries import l_shape


@pytest.fixture(scope="module")
def solution() -> em.Solution[em.Blocks]:
    u = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
    return em.solve(em.Problem(monitor=em.LeastError(u=u), domain=l_shape(600)))


def test_errors_are_compared_with_the_initial_mesh(solution: em.Solution[em.Blocks]) -> None:
    comparison, errors = solution.against_uniform, solution.interpolation
    assert errors is not None
    assert comparison.uniform.mesh is solution.initial
    for measured, l2 in ((comparison.adapted, errors.l2), (comparison.uniform, errors.l2_uniform)):
        assert measured.error is not None
        mesh = measured.mesh
        assert not mesh.is_grid
        assert np.sqrt((measured.error**2 * mesh.cell_areas()).sum()) == pytest.approx(l2, rel=1e-6)


def test_the_certificate_and_the_history_are_plain_numbers(solution: em.Solution[em.Blocks]) -> None:
    summary = json.loads(json.dumps(solution.certificate.summary()))
    assert summary["status"] == "completed"
    assert summary["interpolation_gain"]["l2"] > 1.5
    assert summary["min_jacobian"] == pytest.approx(solution.mesh.min_jacobian)
    assert summary["compared_with"] == "initial"
    assert solution.warnings == solution.certificate.warnings
    said = str(solution.certificate)
    assert "(error on the initial mesh over that on this one)" in said
    assert "(1 for a parallelogram of the mean area)" in said
    assert "uniform" not in said
    history = json.loads(json.dumps(solution.convergence()))
    assert history["descent"][-1]["points"] == solution.problem.points
    assert str(solution.problem.points) in repr(solution)


def test_the_contents_of_a_file_have_the_block_of_every_cell(solution: em.Solution[em.Blocks]) -> None:
    data = solution.data()
    assert data.u is not None
    assert data.u == pytest.approx(solution.problem.monitor.u.evaluate(solution.mesh.x, solution.mesh.y)[0])
    assert data.q_eq.shape == (len(solution.mesh.cells),)
    counts = np.bincount(data.subdomain)
    assert counts.tolist() == [cells.size for cells in solution.mesh.block_cells]


def test_a_coarse_mesh_of_a_steep_function_is_warned_about() -> None:
    u = em.Expression("tanh(300*(x + 0.31*y + 0.123))")
    coarse = em.solve(em.Problem(monitor=em.LeastError(u=u), domain=l_shape(100)))
    assert any("does not resolve it" in text or "inside a cell" in text for text in coarse.warnings)
