"""Folds are mended where they are, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.least_error import kernels
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.least_error.kernels import Nodes
from equimesh.least_error.lifting import SMALLEST_SHARE, mended
from equimesh.numerics.types import Array
from equimesh.testing.geometries import disc, naca0012_c

SQUARE = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [12, 12]}],
    "joins": [{"from": ["a", "d"], "to": ["b", "c"]}],
}


def finest(domain: Blocks) -> BlockMesh:
    return BlockMesh.of(domain, block_levels(domain.mesh)[-1])


def smallest(mesh: BlockMesh, unknowns: Array) -> float:
    corners = mesh.cells.corners.reshape(-1)
    here, first = (Nodes(*mesh.chart.nodes(one), corners) for one in (unknowns, mesh.first.unknowns))
    return float(kernels.smallest_share(here, first))


def folded(mesh: BlockMesh, node: int) -> Array:
    """The first mesh with one node, and its copy, moved by three cells."""
    moves = np.zeros_like(mesh.first.unknowns)
    moves[:, node] = 3.0 * mesh.chart.length / np.sqrt(mesh.cells.count)
    moves *= mesh.chart.free
    mesh.cells.tie(moves)
    return mesh.first.unknowns + moves


@pytest.mark.parametrize("place", ["inside", "on the circle"])
def test_a_fold_is_mended_and_the_rest_stays(place: str) -> None:
    domain = disc(800)
    mesh, (x, y) = finest(domain), domain.mesh.points.T
    # Away from the four points where the blocks meet the circle.
    node = int(np.hypot(x - (0.2 if place == "inside" else 1.0), y - 0.1).argmin())
    assert (domain.node_curve[node] >= 0) == (place != "inside")
    before = folded(mesh, node)
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    changed = (after != before).any(axis=0)
    assert 0 < changed.sum() < 40
    assert np.hypot(x - x[node], y - y[node])[changed].max() < 0.3
    on_circle = domain.node_curve >= 0
    assert np.hypot(*np.stack(mesh.chart.nodes(after))[:, on_circle]) == pytest.approx(1.0, abs=1e-13)


def test_tied_nodes_stay_together() -> None:
    domain = Blocks.of(SQUARE)
    mesh = finest(domain)
    copies, originals = mesh.cells.ties.T
    before = folded(mesh, int(originals[len(originals) // 2]))
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    apart = after[:, copies] - after[:, originals]
    assert apart == pytest.approx(mesh.first.unknowns[:, copies] - mesh.first.unknowns[:, originals], abs=1e-14)


def test_a_mesh_without_folds_is_the_same() -> None:
    mesh = finest(disc(400))
    first = mesh.first.unknowns
    assert mended(mesh.chart, mesh.cells, first, first) is first


def test_in_thin_cells_nodes_move_less_than_the_one_that_folds_them() -> None:
    """The mean of the displacements around it would take it back by most of its way."""
    domain = Blocks.of(
        {**SQUARE, "joins": [], "blocks": [{**SQUARE["blocks"][0], "cells": [12, 24], "grading": [1, 2e3]}]}
    )
    mesh, (x, y) = finest(domain), domain.mesh.points.T
    up = 0.05 * np.sin(np.pi * x) * (1.0 - np.exp(-y / 0.03)) * np.exp(-y / 0.3)
    up[np.hypot(x - 0.5, y - 0.02).argmin()] -= 0.02
    before = mesh.first.unknowns + np.stack([np.zeros_like(up), up]) * mesh.chart.free
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
    assert np.abs(after - before).max() < 0.01


def test_what_has_slid_around_the_nose_of_an_airfoil_is_mended_by_shorter_displacements() -> None:
    """Corners that are unfolded one after the other fold each other there."""
    domain = naca0012_c(2000)
    mesh = finest(domain)
    x, y = domain.mesh.points.T
    moves = np.zeros_like(mesh.first.unknowns)
    near = np.hypot(x, y) < 0.05
    moves[:, near] = np.array([[0.05], [0.03]])
    before = mesh.first.unknowns + moves * mesh.chart.free
    assert smallest(mesh, before) < 0.0
    after = mended(mesh.chart, mesh.cells, mesh.first.unknowns, before)
    assert smallest(mesh, after) > SMALLEST_SHARE
