"""Meshes with other numbers of cells, on the same curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from solver.blocks import documents


def as_read(document: dict) -> Blocks:
    """The domain without its description, as of a mesh that somebody made."""
    return replace(Blocks.of(document), _document=None)


@pytest.mark.parametrize("document", [documents.l_shape(), documents.ring(), documents.channel()])
def test_a_refined_mesh_keeps_nodes_curves_and_sides(document: dict) -> None:
    coarse = as_read(document)
    fine = coarse.refined(2)
    assert not fine.mesh.is_folded
    assert fine.area == pytest.approx(coarse.area, rel=1e-12)
    assert fine.layout.shapes == tuple((2 * i - 1, 2 * j - 1) for i, j in coarse.layout.shapes)
    for old, new in zip(coarse.mesh.blocks, fine.mesh.blocks, strict=True):
        assert np.abs(fine.mesh.points[new[::2, ::2]] - coarse.mesh.points[old]).max() < 1e-13
        assert np.array_equal(fine.node_curve[new[::2, ::2]], coarse.node_curve[old])
    assert {name: len(edges) for name, edges in fine.mesh.sides.items()} == {
        name: 2 * len(edges) for name, edges in coarse.mesh.sides.items()
    }
    assert fine.refined(0.5).mesh.distance(coarse.mesh) < 1e-12
    gap = fine.mesh.points[fine.mesh.ties[:, 0]] - fine.mesh.points[fine.mesh.ties[:, 1]]
    assert np.abs(gap - [3.0, 0.0]).max(initial=0.0) < 1e-14


def test_new_nodes_of_a_smooth_block_are_accurate() -> None:
    exact = Blocks.of(documents.ring(refine=4)).mesh
    found = as_read(documents.ring(refine=2)).refined(2).mesh
    assert found.distance(exact) < 2e-4


def test_a_mesh_that_folds_is_refused() -> None:
    found = as_read(documents.ring())
    points = found.mesh.points.copy()
    block = found.mesh.blocks[0]
    points[block[1:-1]] = 0.98 * points[block[-1]] + 0.02 * points[block[1:-1]]
    squeezed = replace(found, mesh=found.mesh.moved(points))
    assert not squeezed.mesh.is_folded
    with pytest.raises(em.InputError, match=r"block0 folds at .*: take a factor nearer to 1"):
        squeezed.refined(3)
