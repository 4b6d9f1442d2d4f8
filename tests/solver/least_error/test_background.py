"""Smooth displacements of the nodes of any mesh by splines on a background grid."""

from __future__ import annotations

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.paved import Background, Boundary, background_counts
from equimesh.testing.geometries import disc

RANDOM = np.random.default_rng(7)


def boundary_of(domain: Blocks) -> tuple[Boundary, CurveChart, np.ndarray]:
    chart = CurveChart(domain.curves, domain.node_curve, domain.node_parameter, domain.area)
    first = chart.unknowns(np.ascontiguousarray(domain.mesh.points.T), domain.node_parameter)
    return Boundary(chart, first, domain.mesh.cells), chart, first


def test_pulling_back_is_the_transpose_of_moving() -> None:
    domain = disc(400)
    boundary, _, _ = boundary_of(domain)
    background = Background(boundary, np.ascontiguousarray(domain.mesh.points.T), 4)
    coefficients, gradient = RANDOM.normal(size=(2, background.count)), RANDOM.normal(size=(2, domain.points))
    one = np.vdot(background.moves(coefficients), gradient)
    assert abs(one - np.vdot(coefficients, background.pulled_back(gradient))) < 1e-11 * abs(one)


def test_a_small_rotation_of_a_disc_slides_its_boundary_and_turns_all_nodes() -> None:
    domain = disc(400)
    boundary, chart, first = boundary_of(domain)
    x, y = domain.mesh.points.T
    moves = boundary.moves(1e-5 * np.stack([-y, x]))
    after = np.stack(chart.nodes(first + moves)) - domain.mesh.points.T
    assert np.abs(after - 1e-5 * np.stack([-y, x])).max() < 1e-9


def test_background_grids_double_while_their_cells_have_nodes_enough() -> None:
    assert background_counts(16 * 16 * 9, 4, 9.0) == [4, 8, 16]
    assert background_counts(20, 4, 9.0) == [4]
