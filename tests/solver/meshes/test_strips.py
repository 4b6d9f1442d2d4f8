"""Strips of rows, and the tree by which sums over them are added."""

from __future__ import annotations

from itertools import pairwise

import pytest

from equimesh.errors import InputError
from equimesh.meshes.parts import Node, cuts_of, nodes_across, nodes_inside, subtree


@pytest.mark.parametrize("strips", [1, 2, 7, 8, 33, 1024])
def test_a_tree_has_every_strip_once(strips: int) -> None:
    tree = subtree(0, strips)
    assert len(tree) == strips - 1
    assert sorted(middle for _, middle, _ in tree.tolist()) == list(range(1, strips))
    assert (tree[:, 1] == (tree[:, 0] + tree[:, 2]) // 2).all()


@pytest.mark.parametrize("strips", [8, 33, 64, 128])
@pytest.mark.parametrize("parts", [1, 2, 3, 4, 5, 6, 7, 8])
def test_parts_are_cut_at_nodes_and_nearly_equal(strips: int, parts: int) -> None:
    cuts = cuts_of(strips, parts)
    sizes = [last - first for first, last in pairwise(cuts)]
    assert (cuts[0], cuts[-1], len(cuts)) == (0, strips, parts + 1)
    assert min(sizes) >= 1
    assert max(sizes) <= 1.25 * strips / parts + 1
    for first, last in pairwise(cuts):
        inside = nodes_inside(strips, first, last)
        assert [k for node in inside for k in range(node.first, node.last)] == list(range(first, last))
        assert len(inside) == 1 or parts & (parts - 1), "parts of a power of two are nodes"
        assert len(inside) <= 8


def test_a_node_across_parts_comes_before_those_inside_it() -> None:
    assert nodes_across(8, (0, 4, 8)) == (Node(0, 4, 8),)
    assert nodes_across(8, (0, 3, 8)) == (Node(0, 4, 8), Node(0, 2, 4), Node(2, 3, 4))
    assert nodes_across(8, (0, 8)) == ()


def test_more_parts_than_strips_are_refused() -> None:
    assert cuts_of(5, 5) == (0, 1, 2, 3, 4, 5)
    with pytest.raises(InputError, match="at most 5 parts, not 6"):
        cuts_of(5, 6)
