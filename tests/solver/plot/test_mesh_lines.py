"""The lines of a mesh: each edge belongs to one subdomain, or to the overlap, and is drawn once."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.mesh import Grid
from equimesh.plot.figure import SHARED_OWNER, MeshLines
from equimesh.plot.meshes import (
    MAX_LINES,
)
from equimesh.schwarz.decomposition import Decomposition
from solver.plot.drawings import result, strips


def test_edges_belong_to_their_subdomain_and_the_shared_columns_to_the_overlap() -> None:
    decomposition = strips(12, 10, overlap=2)
    assert [part.columns for part in decomposition.parts] == [range(7), range(5, 12)]
    data = result(decomposition)
    lines = MeshLines.of(data.mesh, most=MAX_LINES)
    along_xi, along_eta = lines.owners(data.subdomain, decomposition)
    assert along_xi.shape == (11, 10)
    assert along_eta.shape == (12, 9)
    # Between columns 5 and 6 both subdomains hold the edge; the lines of columns 5 and 6 themselves are shared.
    assert (along_xi == np.array([0] * 5 + [SHARED_OWNER] + [1] * 5)[:, None]).all()
    assert (along_eta == np.array([0] * 5 + [SHARED_OWNER] * 2 + [1] * 5)[:, None]).all()


def test_every_edge_is_drawn_exactly_once() -> None:
    decomposition = Decomposition(grid=Grid(n_xi=14, n_eta=11), subdomains=(2, 2), overlap=3)
    data = result(decomposition)
    lines = MeshLines.of(data.mesh, most=MAX_LINES)
    edges = lines.owners(data.subdomain, decomposition)
    assert set(np.union1d(*edges)) == {SHARED_OWNER, 0, 1, 2, 3}
    drawn = [
        (*map(tuple, np.round(piece[k : k + 2], 12).tolist()),)
        for owner in (SHARED_OWNER, 0, 1, 2, 3)
        for piece in lines.polylines(*edges, owner)
        for k in range(len(piece) - 1)
    ]
    assert len(drawn) == len(set(drawn)) == 13 * 11 + 14 * 10
    nodes = {tuple(point) for point in np.round(data.mesh.points, 12).tolist()}
    assert {end for edge in drawn for end in edge} == nodes
