"""The rows of a mesh that a process holds."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, HeldMesh, Mesh
from equimesh.meshes.parts import Parts, row_cuts
from equimesh.numerics.channel import Channel, ThreadChannels

MESH = Mesh.uniform(Grid(n_xi=9, n_eta=5))


def test_rows_that_are_held_begin_somewhere_in_the_grid() -> None:
    some, all_rows = HeldMesh(MESH.grid, 3, MESH.x[3:7], MESH.y[3:7]), HeldMesh.of(MESH)
    assert (some.ends, some.is_whole) == ((3, 7), False)
    assert (all_rows.ends, all_rows.is_whole) == ((0, 9), True)
    assert np.array_equal(some.window(4, 6).x, MESH.x[4:6])


@pytest.mark.parametrize("wanted", [[(0, 30), (40, 80), (70, 130)], [(0, 130)] * 3, [(60, 120), (0, 70), (1, 2)]])
def test_a_part_gets_the_rows_that_it_wants_from_their_owners(wanted: list[tuple[int, int]]) -> None:
    mesh = Mesh.uniform(Grid(n_xi=130, n_eta=2049))
    cuts = row_cuts(mesh.grid.shape, 3)

    def work(channel: Channel) -> HeldMesh:
        rows = Parts.of(mesh.grid.shape, 1, channel).held
        return HeldMesh(mesh.grid, rows.start, mesh.x[rows], mesh.y[rows]).with_rows(wanted, channel)

    for number, found in enumerate(ThreadChannels(3).run(work)):
        assert found.begin == min(wanted[number][0], cuts[number])
        assert found.end == max(wanted[number][1], cuts[number + 1])
        assert np.array_equal(found.x, mesh.x[found.begin : found.end])
        assert np.array_equal(found.y, mesh.y[found.begin : found.end])
