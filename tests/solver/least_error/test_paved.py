"""Descent on meshes whose blocks are too small for coarser meshes."""

from __future__ import annotations

import numpy as np

import equimesh as em
from block_cases import changed
from equimesh.blocks.blocks import Blocks
from equimesh.least_error.paved import is_paved
from equimesh.testing.geometries import disc, l_shape


def paved() -> Blocks:
    """A disc whose blocks are single cells, as those of a mesh without any structure."""
    source = disc(700).mesh
    mesh = Blocks.of_mesh(source.points, source.cells, {}, corner_angle=80)
    cells = tuple(cell[[[0, 3], [1, 2]]] for cell in source.cells)
    object.__setattr__(mesh, "mesh", changed(mesh.mesh, blocks=cells, block_names=()))
    return mesh


def test_blocks_of_single_cells_are_paved_and_structured_ones_are_not() -> None:
    assert is_paved(paved().mesh)
    assert not is_paved(disc(700).mesh)
    assert not is_paved(l_shape(700).mesh)


def test_a_paved_disc_gains_without_coarser_meshes_and_stays_round() -> None:
    domain = paved()
    front = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
    solution = em.solve(em.Problem(monitor=em.LeastError(u=front), domain=domain))
    assert not solution.mesh.is_folded
    assert solution.interpolation is not None
    assert solution.interpolation.estimated_gain("l2") > 3.0
    on = domain.node_curve >= 0
    assert on.any()
    assert np.abs(np.hypot(*solution.mesh.points[on].T) - 1.0).max() < 1e-12
    assert {record["level"] for record in solution.descent} == {0}
    errors = [record["error"] for record in solution.descent]
    assert errors[-1] < errors[0]
