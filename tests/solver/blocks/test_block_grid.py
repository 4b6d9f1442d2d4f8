"""The grid that blocks in rows and columns form: its size, domain and cuts; and blocks that form none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.block_grid import BlockGrid
from equimesh.blocks.blocks import Blocks
from equimesh.testing import geometries
from solver.blocks import documents

COLUMNS, ROWS = (4, 9, 6), (5, 8)


def rows_and_columns(turned: bool = True) -> dict[str, Any]:
    """Three columns and two rows over a circular arc, which goes on over two blocks; blocks are turned differently."""
    xs, ys = (0.0, 0.5, 1.5, 2.0), (0.0, 0.5, 1.0)
    vertices = {f"v{i}{j}": [x, y] for i, x in enumerate(xs) for j, y in enumerate(ys)}
    vertices["v10"] = [0.5, float(np.sqrt(2.0**2 - 0.25**2) - np.sqrt(2.0**2 - 0.75**2))]
    blocks = []
    for i, along in enumerate(COLUMNS):
        for j, across in enumerate(ROWS):
            corners, turn = [f"v{i}{j}", f"v{i + 1}{j}", f"v{i + 1}{j + 1}", f"v{i}{j + 1}"], (2 * i + j) % 4
            turn = turn if turned else 0
            cells = [across, along] if turn % 2 else [along, across]
            blocks.append({"corners": corners[turn:] + corners[:turn], "cells": cells})
    center = [0.75, float(-np.sqrt(2.0**2 - 0.75**2))]
    return {
        "vertices": vertices,
        "curves": {"arc": {"circle": {"center": center, "radius": 2.0}}},
        "edges": [{"from": "v00", "to": "v10", "on": "arc"}, {"from": "v10", "to": "v20", "on": "arc"}],
        "blocks": blocks,
        "sides": {"wall": [["v00", "v10"], ["v10", "v20"], ["v20", "v30"]]},
    }


@pytest.mark.parametrize("turned", [False, True])
def test_blocks_in_rows_and_columns_are_one_grid(turned: bool) -> None:
    blocks = Blocks.of(rows_and_columns(turned))
    found = BlockGrid.of(blocks)
    assert found.grid == em.Grid(n_xi=20, n_eta=14)
    assert found.cuts == ((4, 13), (5,))
    assert found.domain.area == pytest.approx(blocks.area, rel=1e-12)
    assert np.array_equal(np.sort(found.nodes.ravel()), np.arange(blocks.points))
    points = blocks.mesh.points[found.nodes]
    mesh = em.Mesh(points[..., 0].copy(), points[..., 1].copy())
    assert not mesh.is_folded
    assert np.array_equal(found.quad_mesh(mesh).points, blocks.mesh.points)
    for side, line in (("bottom", points[:, 0]), ("top", points[:, -1]), ("left", points[0]), ("right", points[-1])):
        ends = np.array(getattr(found.domain, side).evaluate([0.0, 1.0])[:2]).T
        assert np.abs(ends - line[[0, -1]]).max() < 1e-12, side


def test_a_side_follows_its_curves_through_all_blocks() -> None:
    bottom = BlockGrid.of(Blocks.of(rows_and_columns())).domain.bottom
    assert len(bottom.path.breaks) == 3  # one arc over two blocks, and a straight line
    t = np.linspace(0.0, 1.0, 41)
    x, y, x_t, y_t = bottom.evaluate(t)
    on_arc = x < 1.5
    radius = np.hypot(x - 0.75, y + np.sqrt(2.0**2 - 0.75**2))
    assert np.abs(radius[on_arc] - 2.0).max() < 1e-12
    assert np.abs(y[~on_arc]).max() < 1e-12
    after = np.array(bottom.evaluate(t + 1e-6)[:2])
    slopes = (after - np.array([x, y]))[:, 3:-3] / 1e-6
    assert np.abs(slopes - np.array([x_t, y_t])[:, 3:-3]).max() < 1e-4


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (geometries.l_shape, "re-entrant corner"),
        (geometries.step, "re-entrant corner"),
        (geometries.plus, "re-entrant corner"),
        (geometries.obstacle, "re-entrant corner"),
        (geometries.disc, "singular node"),
        (geometries.ring, "lines are closed from block"),
        (lambda _: Blocks.of(documents.channel()), "lines are closed from block"),
    ],
)
def test_blocks_that_form_no_grid_are_refused_with_the_reason(make: Callable[[int], Blocks], words: str) -> None:
    with pytest.raises(em.InputError, match=words) as caught:
        BlockGrid.of(make(400))
    assert "LeastError" in caught.value.message
    assert caught.value.field == "domain.blocks"


def test_a_mesh_of_another_size_is_refused() -> None:
    found = BlockGrid.of(Blocks.of(rows_and_columns()))
    with pytest.raises(em.InputError, match="4 x 4 points, the blocks 20 x 14"):
        found.quad_mesh(em.Mesh.uniform(em.Grid(n_xi=4, n_eta=4)))
