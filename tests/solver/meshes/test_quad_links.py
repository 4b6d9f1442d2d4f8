"""Neighbours of cells, and edges around nodes."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.cell_edges import MAX_SPOKES, corner_at, links_of, spokes_of
from equimesh.meshes.mesh import Mesh
from solver.meshes.quad_cases import corner, disc, ring


@pytest.mark.parametrize(("mesh", "edges"), [(corner(3), 24), (disc(4), 16), (ring(3), 24)])
def test_neighbours_share_an_edge_the_other_way_round(mesh: Mesh, edges: int) -> None:
    links = links_of(mesh.cells, len(mesh.points))
    cells, at = np.nonzero(links.neighbours >= 0)
    for cell, edge in zip(cells, at, strict=True):
        other = links.neighbours[cell, edge]
        back = list(links.neighbours[other]).index(cell)
        assert mesh.cells[cell, edge] == mesh.cells[other, (back + 1) % 4]
        assert mesh.cells[cell, (edge + 1) % 4] == mesh.cells[other, back]
    assert links.boundary().size == edges
    assert np.all(links.neighbours.reshape(-1)[links.boundary()] == -1)


def test_places_name_every_corner_of_a_node() -> None:
    mesh = disc(2)
    links = links_of(mesh.cells, len(mesh.points))
    for node in range(len(mesh.points)):
        places = links.places[links.starts[node] : links.starts[node + 1]]
        assert np.all(mesh.cells.reshape(-1)[places] == node)
    assert links.places.size == mesh.cells.size


def test_edges_of_a_node_are_counter_clockwise_and_begin_at_the_boundary() -> None:
    for mesh, wanted in ((corner(2), {2, 3, 4}), (disc(2), {3, 4}), (ring(2), {3, 4})):
        links, spokes, found = links_of(mesh.cells, len(mesh.points)), np.empty(MAX_SPOKES, dtype=np.int64), set()
        for node in range(len(mesh.points)):
            count, closed = spokes_of(node, links, spokes)
            found.add(count)
            x, y = (mesh.points[spokes[:count]] - mesh.points[node]).T
            turns = (np.diff(np.arctan2(y, x), append=np.arctan2(y[0], x[0])) + 2 * np.pi) % (2 * np.pi)
            assert np.all(turns[: count if closed else -1] < np.pi)
            assert closed == (links.starts[node + 1] - links.starts[node] == count)
            assert (turns.sum() == pytest.approx(2 * np.pi)) or not closed
        assert found - {4} == wanted - {4}


def test_corner_of_a_node() -> None:
    mesh = corner(2)
    assert [corner_at(mesh.cells, 5, node) for node in mesh.cells[5]] == [0, 1, 2, 3]
