"""The defects are those of the equations that Newton's method with a matrix solves."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import defects, directions
from equimesh.sweeps.line_sums import cell_metrics


def bent(case: em.Problem) -> tuple[Array, Array, Array]:
    """A mesh with random moves inside, and the metric of its cells."""
    mesh, rng = em.Mesh.uniform(case.grid), np.random.default_rng(4)
    x, y = mesh.x.copy(), mesh.y.copy()
    for q in (x, y):
        q[1:-1, 1:-1] += 0.01 * rng.standard_normal((x.shape[0] - 2, x.shape[1] - 2))
    cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
    cell_metrics(case.metric, x, y, cells)
    return x, y, cells


@pytest.mark.parametrize("weight", [0.0, 0.7])
@pytest.mark.parametrize("shape", [(9, 9), (8, 13)])
def test_they_are_the_residual_of_the_equations(shape: tuple[int, int], weight: float) -> None:
    case = problem("ring", *shape)
    x, y, cells = bent(case)
    equations = case.equations(weight)
    expected = equations.residual(equations.vector(em.Mesh(x, y))).reshape(2, *shape)[:, 1:-1, 1:-1]
    found = np.empty_like(expected)
    per_spacing = (float((shape[0] - 1) ** 2), float((shape[1] - 1) ** 2))
    defects(x, y, cells, per_spacing, weight, found)
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(expected).max())


def test_the_directions_are_the_metric_times_the_edges() -> None:
    case = problem("ring", 7, 6)
    x, y, m = bent(case)
    found = np.empty((4, 5, 4))
    directions(x, y, m, found)
    i, j = 3, 2
    mean = m[:, i - 1 : i + 1, j - 1 : j + 1].mean(axis=(1, 2))
    tensor = np.array([[mean[0], mean[1]], [mean[1], mean[2]]])
    along_xi = 0.5 * np.array([x[i + 1, j] - x[i - 1, j], y[i + 1, j] - y[i - 1, j]])
    along_eta = 0.5 * np.array([x[i, j + 1] - x[i, j - 1], y[i, j + 1] - y[i, j - 1]])
    assert found[:2, i - 1, j - 1] == pytest.approx(tensor @ along_xi)
    assert found[2:, i - 1, j - 1] == pytest.approx(tensor @ along_eta)
