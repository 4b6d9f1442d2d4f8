"""Regions: own cells and nodes, layers of the neighbours' cells, and what is held fixed."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import Cells, Region, cells_of_grid, regions_of
from equimesh.meshes.cell_edges import originals_of
from equimesh.numerics.types import IntArray

SHAPE = (14, 11)
CLOSED = [(False, False), (True, False), (True, True)]


def owners(columns: int = 3, rows: int = 2) -> IntArray:
    """The owner of each cell of the grid, in blocks of unequal sizes."""
    i, j = np.arange(SHAPE[0] - 1) * columns // SHAPE[0], np.arange(SHAPE[1] - 1) * rows // SHAPE[1]
    return (i[:, None] * rows + j).ravel()


def cells_in_mesh(region: Region, cells: Cells) -> IntArray:
    """The numbers in the mesh of the cells of a region."""
    numbers = {tuple(corners): number for number, corners in enumerate(cells.corners.tolist())}
    return np.array([numbers[tuple(corners)] for corners in region.nodes[region.cells.corners].tolist()])


@pytest.mark.parametrize("closed", CLOSED)
def test_every_cell_node_and_triple_has_one_owner(closed: tuple[bool, bool]) -> None:
    cells, owner = cells_of_grid(SHAPE, closed), owners()
    regions = regions_of(cells, owner, 2)
    nodes = np.concatenate([region.nodes[region.owned] for region in regions])
    assert np.array_equal(np.sort(nodes), np.arange(cells.nodes))
    for region in regions:
        assert np.array_equal(cells_in_mesh(region, cells)[: region.own_cells], np.flatnonzero(owner == region.number))
    assert sum(region.own_triples for region in regions) == len(cells.triples)


@pytest.mark.parametrize("closed", CLOSED)
@pytest.mark.parametrize("overlap", [1, 2, 3])
def test_a_node_is_free_where_all_its_cells_are_within_the_overlap(closed: tuple[bool, bool], overlap: int) -> None:
    cells, owner = cells_of_grid(SHAPE, closed), owners()
    stands = originals_of(cells.nodes, cells.ties)
    corners = stands[cells.corners]
    for region in regions_of(cells, owner, overlap):
        near = owner == region.number
        for _ in range(overlap):
            near = np.isin(corners, corners[near]).any(axis=1)
        held = np.isin(stands, corners[~near])
        expected = cells.free * np.where(held, 0.0, 1.0)
        assert np.array_equal(region.cells.free, expected[:, region.nodes])
        every = np.flatnonzero(np.isin(corners, corners[near]).any(axis=1))
        assert np.array_equal(np.sort(cells_in_mesh(region, cells)), every)


@pytest.mark.parametrize("closed", CLOSED)
def test_all_second_differences_of_free_nodes_are_in_the_region(closed: tuple[bool, bool]) -> None:
    cells = cells_of_grid(SHAPE, closed)
    stands = originals_of(cells.nodes, cells.ties)
    for region in regions_of(cells, owners(), 2):
        there = {tuple(triple) for triple in stands[region.nodes[region.cells.triples]].tolist()}
        free = np.unique(stands[region.nodes[region.cells.free.any(axis=0)]])
        wanted = cells.triples[np.isin(cells.triples, free).any(axis=1)]
        assert {tuple(triple) for triple in wanted.tolist()} <= there


def test_copies_of_a_free_node_move_together() -> None:
    cells = cells_of_grid(SHAPE, (True, False))
    stands = originals_of(cells.nodes, cells.ties)
    region = regions_of(cells, owners(), 2)[0]
    copies, first = region.nodes[region.cells.ties].T
    assert copies.size > 0
    assert np.array_equal(stands[copies], stands[first])
    assert not np.isin(region.cells.triples, region.cells.ties[:, 0]).any()


def test_cuts_through_corners_keep_their_cells() -> None:
    cells = cells_of_grid(SHAPE)
    found = {}
    for region in regions_of(cells, owners(), 1):
        numbers = cells_in_mesh(region, cells)
        found |= {int(numbers[cell]): cut for cell, cut in region.cells.corner_cuts.items()}
    assert found == dict(cells.corner_cuts)


def test_the_sides_of_a_region_are_those_of_the_mesh_that_it_has() -> None:
    cells = cells_of_grid((9, 9))
    owner = em.Schwarz(subdomains=(2, 2)).owner_of_cells(em.Grid(n_xi=9, n_eta=9))
    sides = {frozenset(edge) for edge in cells.sides.tolist()}
    found = [{frozenset(edge) for edge in r.nodes[r.cells.sides].tolist()} for r in regions_of(cells, owner, 1)]
    assert set().union(*found) == sides
    assert all(0 < len(here) < len(sides) for here in found)
