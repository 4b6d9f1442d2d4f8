"""The rows of a mesh that a process holds."""

from __future__ import annotations

from equimesh.meshes.grid import Grid
from equimesh.meshes.held_mesh import HeldMesh
from equimesh.meshes.mesh import Mesh

MESH = Mesh.uniform(Grid(n_xi=9, n_eta=5))


def test_rows_that_are_held_begin_somewhere_in_the_grid() -> None:
    some, all_rows = HeldMesh(MESH.grid, 3, MESH.x[3:7], MESH.y[3:7]), HeldMesh(MESH.grid, 0, MESH.x, MESH.y)
    assert (some.end, some.is_whole) == (7, False)
    assert (all_rows.end, all_rows.is_whole) == (9, True)
