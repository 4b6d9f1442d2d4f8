"""Interpolation from a coarser mesh in blocks: exact for cubics along lines, and equal on both sides of an edge."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.block_levels import BlockLevel, block_levels
from equimesh.least_error.lifting import Lifting
from equimesh.testing.geometries import disc, l_shape, ring


def last_levels(domain: Blocks) -> tuple[BlockLevel, BlockLevel]:
    coarse, fine = block_levels(domain.mesh)[-2:]
    return coarse, fine


@pytest.mark.parametrize(("cubic", "degree"), [(True, 3), (False, 1)])
def test_polynomials_of_a_grid_of_equal_cells_are_lifted_exactly(cubic: bool, degree: int) -> None:
    domain = l_shape(1500)
    coarse, fine = last_levels(domain)
    x, y = domain.mesh.points.T
    values = np.stack([x**degree - 2.0 * y**degree, 1.0 + x * y])
    lifted = Lifting(coarse, fine).lifted(values[:, coarse.nodes], cubic=cubic)
    assert lifted == pytest.approx(values, abs=1e-13)


@pytest.mark.parametrize("make", [disc, ring, l_shape])
@pytest.mark.parametrize("cubic", [True, False])
def test_nodes_of_both_levels_keep_their_values(make, cubic: bool) -> None:  # type: ignore[no-untyped-def]
    coarse, fine = last_levels(make(1500))
    values = np.random.default_rng(1).normal(size=(2, coarse.points))
    lifting = Lifting(coarse, fine)
    lifted = lifting.lifted(values, cubic=cubic)
    assert np.array_equal(lifted[:, np.searchsorted(fine.nodes, coarse.nodes)], values)
    along = lifting.lifted_along_sides(values[0], cubic=cubic)
    edge = coarse.blocks[0][-1]
    assert np.array_equal(along[np.searchsorted(fine.nodes, coarse.nodes[edge])], values[0, edge])


def test_a_closed_line_is_smooth_where_it_is_cut() -> None:
    domain = ring(3000)
    coarse, fine = last_levels(domain)
    angle = np.arctan2(domain.mesh.y, domain.mesh.x)
    values = np.stack([np.cos(angle), np.sin(angle)])
    lifted = Lifting(coarse, fine).lifted(values[:, coarse.nodes], cubic=True)
    errors = np.abs(lifted - values).max(axis=0)
    first = domain.mesh.blocks[0]
    at_cut = errors[first[:, :2]].max(), errors[first[:, -2:]].max()
    assert max(at_cut) <= 1.001 * errors.max()
    assert errors.max() < 1e-4
    assert max(at_cut) == pytest.approx(min(at_cut), rel=1e-6, abs=1e-12)
