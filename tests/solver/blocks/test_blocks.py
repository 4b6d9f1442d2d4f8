"""Domains of blocks: area, round trips, refinement, counts through opposite edges, numbering, and named sides."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.counts import Plan, plan_of
from equimesh.blocks.description import Description
from equimesh.blocks.grading import grading_of, is_same, reversed_grading, shares
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, TOP, Layout, line_of
from equimesh.blocks.sliding import FIXED, FREE
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.solver_files import su2_text
from equimesh.testing import geometries
from solver.blocks import documents


def test_area_and_box_are_those_inside_the_curves() -> None:
    corner = Blocks.of(documents.l_shape())
    assert corner.area == pytest.approx(3.0, abs=1e-14)
    assert corner.box == ((0.0, 2.0), (0.0, 2.0))
    ring = Blocks.of(documents.ring())
    assert ring.area == pytest.approx(3 * math.pi, rel=1e-13)
    assert np.array(ring.box) == pytest.approx(np.array([[-2, 2], [-2, 2]]), abs=1e-9)
    between = Blocks.of(documents.ring(blocks=[{"corners": ["i", "o", "o", "i"], "cells": [3, 10]}]))
    assert np.array(between.box) == pytest.approx(np.array([[-2, 2], [-2, 2]]), abs=1e-9)
    assert between.mesh.y.max() < 1.95
    bump = Blocks.of(documents.channel())
    top = math.sqrt(5) - 2
    segment = 5 * math.asin(1 / math.sqrt(5)) - 2
    assert bump.area == pytest.approx(3 - segment, rel=1e-12)
    assert bump.points == len(bump.mesh.points)
    assert bump.mesh.block_mesh(0).y[3, 0] == pytest.approx(top)


def test_a_description_comes_back_exactly(tmp_path: Path) -> None:
    for document in (documents.l_shape(), documents.ring(kind="blocks"), documents.channel(refine=2)):
        text = json.dumps(document)
        found = Blocks.of(json.loads(text))
        assert json.dumps(found.description()) == text
        again = Blocks.of(found.description())
        assert np.array_equal(again.mesh.points, found.mesh.points)
    found.description()["blocks"].clear()
    assert found.description()["blocks"]
    (tmp_path / "wall.csv").write_text("0, 0\n0.5, -0.1\n1, 0\n")
    document = documents.l_shape(
        curves={"wall": {"points": "wall.csv"}}, edges=[{"from": "a", "to": "b", "on": "wall"}]
    )
    inlined = Blocks.of(document, tmp_path).description()
    assert inlined["curves"]["wall"]["points"] == [[0.0, 0.0], [0.5, -0.1], [1.0, 0.0]]


def test_refined_domains_have_more_cells_on_the_same_curves() -> None:
    coarse = Blocks.of(documents.ring())
    fine = coarse.refined(2)
    assert fine.layout.shapes == ((9, 49),)
    assert np.abs(fine.mesh.block_mesh(0).x[::2, ::2] - coarse.mesh.block_mesh(0).x).max() < 1e-12
    assert fine.refined(0.5).layout.shapes == coarse.layout.shapes
    with pytest.raises(em.InputError, match="factor = 0: a positive number"):
        coarse.refined(0)


def test_a_domain_without_description_says_so() -> None:
    found = Blocks.of(documents.l_shape())
    other = Blocks.assembled(found.mesh, found.layout, curves=(), on_curves={})
    assert np.array_equal(other.node_curve, found.node_curve)
    with pytest.raises(em.InputError, match="came from a mesh"):
        other.description()


@pytest.mark.parametrize("name", ["l_shape", "cylinder", "naca0012_o", "naca0012_c", "ring", "disc", "pitz_daily"])
def test_the_mesh_of_a_description_has_the_same_blocks_when_it_is_taken_apart(name: str) -> None:
    wanted = getattr(geometries, name)(600)
    mesh = wanted.mesh
    found = Blocks.of_mesh(mesh.points, mesh.cells, mesh.sides, corner_angle=80.0 if name.startswith("naca") else None)
    assert found.mesh.sides.keys() == mesh.sides.keys()
    for side, edges in mesh.sides.items():
        np.testing.assert_array_equal(np.unique(found.mesh.sides[side], axis=0), np.unique(edges, axis=0))
    assert found.layout.block_count <= wanted.layout.block_count
    assert found.area == pytest.approx(wanted.area, rel=2e-3)
    corners = np.flatnonzero(wanted.node_curve == FIXED)
    if name != "naca0012_c":  # where its circle goes over into straight lines the boundary does not turn
        assert set(np.flatnonzero(found.node_curve == FIXED)) >= set(corners)
    assert ((found.node_curve == FREE) == (wanted.node_curve == FREE)).all()


def test_domains_from_files(tmp_path: Path) -> None:
    (tmp_path / "l.json").write_text(json.dumps(documents.l_shape()))
    first = Blocks.read(tmp_path / "l.json")
    assert first.description() == documents.l_shape()
    (tmp_path / "mesh.su2").write_text(su2_text(first.mesh.points, first.mesh.cells, first.mesh.sides))
    mesh = Blocks.read(tmp_path / "mesh.su2", corners=[0])
    np.testing.assert_array_equal(mesh.mesh.points, first.mesh.points)
    assert mesh.layout.block_count == 3
    assert mesh.node_curve[0] == FIXED
    (tmp_path / "blockMeshDict").write_text(
        "vertices ((0 0 0) (1 0 0) (1 1 0) (0 1 0) (0 0 1) (1 0 1) (1 1 1) (0 1 1));"
        " blocks (hex (0 1 2 3 4 5 6 7) (3 2 1) simpleGrading (1 1 1));"
    )
    assert Blocks.read(tmp_path / "blockMeshDict").layout.shapes == ((4, 3),)
    with pytest.raises(em.InputError, match="a description has its own corners"):
        Blocks.read(tmp_path / "l.json", corners=[0])
    with pytest.raises(em.InputError, match=r"the suffix of mesh.stl"):
        Blocks.read(tmp_path / "mesh.stl")


def test_corners_of_a_file_by_name() -> None:
    grid = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    plain = PlainMesh(points=grid.points, cells=grid.cells, sides=grid.sides, places={"te": 8})
    assert Blocks.of_plain(plain, corners=["te"]).layout.block_count == 2


# Meshes with other numbers of cells, on the same curves.


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
    count, blocks = layout.with_counts(2 * layout.counts).numbering()
    assert [b.shape for b in blocks] == [(9, 11), (7, 11), (9, 13)]
    assert count == layout.with_counts(2 * layout.counts).node_count


def test_counts_of_a_budget_are_the_largest_in_proportion() -> None:
    layout, least = layout_of(documents.l_shape()), np.full(4, 2)
    for points in (60, 500, 4001):
        counts = layout.within(points, layout.counts.astype(float), least)
        assert 0.9 * points < layout.with_counts(counts).node_count <= points
        assert counts == pytest.approx(counts.sum() / layout.counts.sum() * layout.counts, abs=1.0)
    assert layout.within(5, np.array([1e-9, 1.0, 1.0, 1.0]), least).tolist() == [2, 2, 2, 2]


@pytest.mark.parametrize("document", [documents.l_shape(), documents.ring()], ids=["L", "ring"])
def test_a_domain_takes_other_counts_and_those_of_a_mesh(document: dict[str, Any]) -> None:
    domain = Blocks.of(document)
    wanted = domain.layout.counts + 1 + np.arange(len(domain.layout.counts))
    of_mesh = Blocks.of_mesh(domain.mesh.points, domain.mesh.cells, domain.mesh.sides)
    for one in (domain, of_mesh):
        counts = wanted if one is domain else one.layout.counts + 1
        found = one.with_counts(counts)
        assert found.layout.counts.tolist() == counts.tolist()
        assert found.area == pytest.approx(domain.area)
        assert one.with_counts_of(found.mesh).layout.counts.tolist() == counts.tolist()
        assert one.with_counts(one.layout.counts) is one.with_counts_of(one.mesh) is one
    finer = domain.with_counts(2 * domain.layout.counts)
    assert np.abs(finer.mesh.points - domain.refined(2).mesh.points).max() < 1e-14


@pytest.mark.parametrize("counts", [[3], [0, 1, 1, 1], [1.5, 2, 2, 2], "ab"])
def test_counts_that_are_not_one_for_each_class_are_refused(counts: Any) -> None:
    with pytest.raises(em.InputError, match="4 whole positive numbers are needed") as refused:
        Blocks.of(documents.l_shape()).with_counts(counts)
    assert refused.value.field == "counts"


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Blocks.rectangle(points=5), "points is a single number: .* cells tells how many cells there are"),  # type: ignore[arg-type]
        (lambda: Blocks.of_mesh(*ONE_CELL, {}, corners=5), "corners is a single number: it must be a list of numbers"),  # type: ignore[arg-type]
        (lambda: Blocks.of_mesh(*ONE_CELL, 5), "sides is a single number"),  # type: ignore[arg-type]
        (lambda: Blocks.of_mesh(*ONE_CELL, {}, names=5), "names is a single number"),  # type: ignore[arg-type]
    ],
)
def test_a_number_in_place_of_a_list_is_refused(build: Callable[[], Blocks], message: str) -> None:
    with pytest.raises(em.InputError, match=message):
        build()


ONE_CELL: Any = ([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2, 3]])


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


def plan(document: dict) -> Plan:
    return plan_of(Description.of(document))


def test_counts_and_gradings_spread_through_opposite_edges() -> None:
    found = plan(documents.l_shape())
    assert found.layout.shapes == ((5, 6), (4, 6), (5, 7))
    graded = {found.layout.edge_name(k) for k, grading in enumerate(found.gradings) if grading[0][2] != 1}
    assert graded == {"a-b", "d-e", "g-h"}
    assert plan(documents.l_shape(refine=2)).layout.shapes == ((9, 11), (7, 11), (9, 13))
    assert plan(documents.l_shape(refine=0.01)).layout.shapes == ((2, 2),) * 3


def test_edges_give_counts_and_gradings_and_joins_carry_them() -> None:
    document = documents.channel(edges=[{"from": "d", "to": "a", "cells": 7, "grading": 5}])
    document["blocks"] = [{"corners": b["corners"], "cells": [6, None]} for b in document["blocks"]]
    found = plan(document)
    assert found.layout.shapes == ((7, 8), (7, 8))
    edge = found.find(("c", "f"), "domain")
    assert found.layout.edge_name(edge) == "c-f"
    assert found.gradings[edge][0][2] == pytest.approx(1 / 5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["blocks"][1].update(cells=[3, 9]), r"the edge b-e has 5 cells by blocks\[0\].cells, but 9 by"),
        (
            lambda d: d["blocks"][0].pop("cells"),
            "no block gives the cells along the edge a-d, .*: give a number in place of null",
        ),
        (lambda d: d["blocks"][2].update(grading=[3, None]), "the edge d-e has two gradings"),
        (lambda d: d["blocks"][1].update(corners=["b", "e", "f", "c"]), "lie on the same side .* b-e"),
        (lambda d: d["vertices"].update(z=[9, 9]), "vertex z is no corner of a block"),
        (lambda d: d.update(edges=[{"from": "a", "to": "e"}]), "a-e is no edge of a block"),
        (lambda d: d.update(edges=[{"from": "a", "to": "b"}, {"from": "b", "to": "a"}]), "b-a stands twice"),
        (lambda d: d.update(joins=[{"from": ["a", "b"], "to": ["b", "e"]}]), "edge b-e is inside, or joined already"),
        (lambda d: d.update(joins=[{"from": ["a", "d"], "to": ["c", "b"]}]), "c-b is inside|no copies of each other"),
        (lambda d: d.update(joins=[{"from": ["a", "z"], "to": ["c", "f"]}]), "is no vertex"),
        (lambda d: d.update(refine=10_000), "nodes: 50000000 are possible"),
        (lambda d: d["blocks"].append(d["blocks"][0]), "is a side of 3 blocks|same side"),
    ],
)
def test_contradictions_are_refused_by_the_name_of_the_edge(change: object, message: str) -> None:
    document = documents.l_shape()
    change(document)
    with pytest.raises(em.InputError, match=message):
        plan(document)


def test_counts_of_opposite_edges_that_differ_name_both_entries() -> None:
    document = documents.l_shape()
    document["edges"] = [{"from": "c", "to": "f", "cells": 8}]
    with pytest.raises(em.InputError, match=r"edges .*c-f.* have \d cells by .*, but \d by") as caught:
        plan(document)
    assert caught.value.field.endswith(".cells")


def test_joined_edges_must_be_copies() -> None:
    document = documents.channel()
    document["vertices"]["f"] = [3, 1.2]
    with pytest.raises(
        em.InputError, match=r"a-d and c-f are no copies .* c lies \(3, 0\) from a, .* \(3, 0.2\) from d"
    ):
        plan(document)


def test_cells_grow_by_one_factor_up_to_the_ratio() -> None:
    cells = np.diff(shares(grading_of(8, "g"), 4))
    assert cells[1:] / cells[:-1] == pytest.approx([2.0, 2.0, 2.0])
    assert cells[-1] / cells[0] == pytest.approx(8.0)
    assert shares(grading_of(1, "g"), 4).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_sections_share_length_and_cells() -> None:
    places = shares(grading_of([[1, 3, 1], [3, 1, 1]], "g"), 8)
    assert places == pytest.approx([*np.linspace(0, 0.25, 7), 0.625, 1.0])
    assert shares(grading_of([[1, 1, 2], [1, 1, 2]], "g"), 1).tolist() == [0.0, 1.0]
    assert len(shares(grading_of([[1, 9, 2], [1, 0.001, 2]], "g"), 3)) == 4


def test_a_reversed_grading_gives_the_same_nodes_from_the_other_end() -> None:
    grading = grading_of([[1, 1, 4], [2, 1, 0.5]], "g")
    assert 1 - shares(reversed_grading(grading), 10)[::-1] == pytest.approx(shares(grading, 10))
    assert is_same(reversed_grading(reversed_grading(grading)), grading)
    assert not is_same(reversed_grading(grading), grading)


@pytest.mark.parametrize("value", [0, -1, "2", None, True, [], [[1, 2]], [[1, 1, 0]], [3, 4], 1e7])
def test_other_gradings_are_refused(value: object) -> None:
    with pytest.raises(em.InputError, match=r"blocks\[0\]\.grading") as caught:
        grading_of(value, "domain.blocks[0].grading")
    assert caught.value.field.startswith("domain.blocks[0].grading")


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
