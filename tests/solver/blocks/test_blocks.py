"""Domains of blocks: area, box, round trips, refinement."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
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
