"""Named sides: order, direction, and edges that are no boundary."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from solver.blocks import documents


@pytest.mark.parametrize("document", [documents.l_shape(), documents.ring(), documents.channel()])
def test_sides_cover_the_boundary_once_with_the_domain_on_their_left(document: dict) -> None:
    mesh = Blocks.of(document).mesh
    directed = {tuple(edge) for cell in mesh.cells.tolist() for edge in zip(cell, cell[1:] + cell[:1], strict=True)}
    boundary = {edge for edge in directed if edge[::-1] not in directed}
    named = [tuple(edge) for edges in mesh.sides.values() for edge in edges.tolist()]
    assert len(named) == len(set(named))
    assert set(named) == boundary


def test_edges_follow_each_other_whatever_their_order() -> None:
    for pairs in ([["g", "d"], ["a", "d"]], [["a", "d"], ["d", "g"]]):
        edges = Blocks.of(documents.l_shape(sides={"inlet": pairs})).mesh.sides["inlet"]
        assert np.array_equal(edges[1:, 0], edges[:-1, 1])
        assert len(edges) == 11
    ring = Blocks.of(documents.ring()).mesh.sides
    assert list(ring) == ["hole", "boundary"]
    assert ring["hole"][-1, 1] == ring["hole"][0, 0]
    assert np.array_equal(ring["hole"][1:, 0], ring["hole"][:-1, 1])


def test_edges_without_a_name_have_one_side_and_joined_ones_a_pair() -> None:
    assert list(Blocks.of(documents.channel()).mesh.sides) == ["periodic0", "periodic0_copy", "boundary"]
    named = documents.channel(sides={"inflow": [["a", "d"]], "boundary": [["e", "d"]]})
    assert list(Blocks.of(named).mesh.sides) == ["inflow", "boundary", "periodic0_copy", "unnamed"]


@pytest.mark.parametrize(
    ("sides", "message"),
    [
        ({"wall": [["b", "e"]]}, "b-e is no edge of the boundary"),
        ({"wall": [["a", "e"]]}, "a-e is no edge of a block"),
        ({"wall": [["a", "b"]], "floor": [["b", "a"]]}, "b-a belongs to the side wall already"),
    ],
)
def test_edges_that_are_no_boundary_are_refused(sides: dict, message: str) -> None:
    with pytest.raises(em.InputError, match=message) as caught:
        Blocks.of(documents.l_shape(sides=sides))
    assert caught.value.field.startswith(f"domain.sides.{list(sides)[-1]}[0]")
