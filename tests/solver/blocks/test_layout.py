"""Topology of blocks: counts, numbering, neighbours, ties."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, TOP, Layout, line_of
from solver.blocks import documents


def layout_of(document: dict) -> Layout:
    return plan_of(Description.of(document)).layout


def test_each_node_has_one_number_and_blocks_share_those_of_their_edges() -> None:
    for document in (documents.l_shape(), documents.ring(), documents.channel()):
        layout = layout_of(document)
        count, blocks = layout.numbering()
        assert count == layout.node_count == len(set(np.concatenate([b.ravel() for b in blocks]).tolist()))
        assert blocks[0].ravel()[0] == 0
        assert sum((b.shape[0] - 1) * (b.shape[1] - 1) for b in blocks) == layout.cell_count
        for b, side in np.ndindex(layout.block_count, 4):
            other, there, falls = layout.neighbours[b, side].tolist()
            if other >= 0 and not len(layout.joins):
                line = line_of(blocks[other], there)[:: -1 if falls else 1]
                assert np.array_equal(line_of(blocks[b], side), line)


def test_one_block_is_numbered_as_a_structured_mesh() -> None:
    document = {
        "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
        "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [3, 4]}],
    }
    assert layout_of(document).numbering()[1][0].tolist() == np.arange(20).reshape(4, 5).tolist()


def test_neighbours_know_where_the_index_falls() -> None:
    turned = documents.l_shape()
    turned["blocks"][2]["corners"] = ["h", "g", "d", "e"]  # turned by half a turn
    assert layout_of(documents.l_shape()).neighbours[0, TOP].tolist() == [2, BOTTOM, 0]
    assert layout_of(turned).neighbours[0, TOP].tolist() == [2, TOP, 1]
    assert layout_of(documents.ring()).neighbours[0].tolist()[2:] == [[0, TOP, 0], [0, BOTTOM, 0]]
    assert layout_of(documents.channel()).neighbours[0, LEFT].tolist() == [1, RIGHT, 0]


def test_opposite_edges_are_one_class_and_change_together() -> None:
    layout = layout_of(documents.l_shape())
    assert sorted(layout.counts.tolist()) == [3, 4, 5, 6]
    assert layout.coarser(2).shapes == ((3, 4), (3, 4), (3, 4))
    assert layout.coarser(100).shapes == ((2, 2),) * 3
    count, blocks = layout.numbering(2 * layout.counts)
    assert [b.shape for b in blocks] == [(9, 11), (7, 11), (9, 13)]
    assert count == layout.with_counts(2 * layout.counts).node_count


def test_ties_have_one_original_where_joins_meet() -> None:
    square = {
        "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
        "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [3, 3]}],
        "joins": [{"from": ["a", "d"], "to": ["b", "c"]}, {"from": ["a", "b"], "to": ["d", "c"]}],
    }
    layout = layout_of(square)
    _, blocks = layout.numbering()
    ties = dict(layout.ties(blocks).tolist())
    block = blocks[0]
    assert len(ties) == 16 - 9
    assert {ties[int(block[i, j])] for i, j in ((3, 0), (0, 3), (3, 3))} == {int(block[0, 0])}
    assert ties[int(block[3, 1])] == block[0, 1]
    assert ties[int(block[2, 3])] == block[2, 0]
    assert not len(layout.boundary)


def test_counts_that_differ_are_refused() -> None:
    layout = layout_of(documents.l_shape())
    counts = layout.edge_counts.copy()
    counts[layout.block_edges[0, LEFT]] += 1
    with pytest.raises(em.InputError, match=r"the edges a-d and b-e are opposite, and have 6 and 5 cells"):
        Layout(
            edges=layout.edges,
            block_edges=layout.block_edges,
            forward=layout.forward,
            edge_counts=counts,
            vertex_names=layout.vertex_names,
        )
