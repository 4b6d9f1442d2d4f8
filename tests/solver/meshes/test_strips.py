"""Strips of rows, and the tree by which sums over them are added."""

from __future__ import annotations

import pytest

from equimesh.meshes.rows import subtree


@pytest.mark.parametrize("strips", [1, 2, 7, 8, 33, 1024])
def test_a_tree_has_every_strip_once(strips: int) -> None:
    tree = subtree(0, strips)
    assert len(tree) == strips - 1
    assert sorted(middle for _, middle, _ in tree.tolist()) == list(range(1, strips))
    assert (tree[:, 1] == (tree[:, 0] + tree[:, 2]) // 2).all()
