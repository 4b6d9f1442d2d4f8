"""Estimates of the error of values on blocks."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.kernels import Rule
from equimesh.rounds.recovery import Recovery, measured, moved_cells
from equimesh.testing.geometries import disc, l_shape

DOMAIN = l_shape(300)


def test_the_estimate_is_near_the_error_of_smooth_values() -> None:
    mesh, u = DOMAIN.mesh, em.Expression("sin(4*x + y)")
    known = Recovery.of(mesh, u.evaluate(mesh.x, mesh.y)[0], DOMAIN)
    for norm in ("l2", "h1"):
        wanted = measured(u, DOMAIN, mesh, Rule(norm=norm, points=3))
        assert known.estimate(norm) == pytest.approx(wanted, rel=0.1)


def test_a_linear_function_has_no_error_but_rounding() -> None:
    mesh = DOMAIN.mesh
    known = Recovery.of(mesh, 1 + 2 * mesh.x - mesh.y, DOMAIN)
    assert known.estimate("l2") < known.rounding
    assert known.gradient_norm() == pytest.approx(np.sqrt(5 * DOMAIN.area))


def test_the_measured_error_is_that_of_the_quality() -> None:
    monitor = em.LeastError(u=em.Expression("tanh(9*(x - y))"))
    solution = em.solve(em.Problem(monitor=monitor, domain=DOMAIN), threads=1)
    for mesh, wanted in ((solution.mesh, solution.interpolation.l2), (DOMAIN.mesh, solution.interpolation.l2_uniform)):
        assert measured(monitor.u, DOMAIN, mesh, Rule(norm="l2", points=4)) == pytest.approx(wanted, rel=1e-3)


def test_moves_count_in_lengths_of_the_mean_cell() -> None:
    mesh = DOMAIN.mesh
    length = np.sqrt(DOMAIN.area / len(mesh.cells))
    assert moved_cells(mesh, mesh.moved(mesh.points + np.array([0.0, 0.5 * length]))) == pytest.approx(0.5)


def test_values_on_another_mesh_are_refused() -> None:
    other = disc(300).mesh
    with pytest.raises(em.InputError, match="other cells than the domain"):
        Recovery.of(other, other.x, DOMAIN)
