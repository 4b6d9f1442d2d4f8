"""What a part has of a solution."""

from __future__ import annotations

import pickle

import numpy as np

import equimesh as em
from equimesh.meshes.held_mesh import HeldMesh
from equimesh.solving.status import Status
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.parts.part_solution import PartSolution


def test_a_part_of_a_solution_can_be_pickled() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("x*y")), grid=em.Grid(n_xi=9, n_eta=5))
    mesh = em.Mesh.uniform(problem.grid)
    part = PartSolution(
        problem=problem,
        mode=em.Mode.TIGHT,
        status=Status.CONVERGED,
        mesh=cut(mesh, [4])[1],
        reference=HeldMesh(mesh.grid, 3, mesh.x[3:], mesh.y[3:]),
        newton_steps=3,
        residual=1e-11,
    )
    again = pickle.loads(pickle.dumps(part))
    assert np.array_equal(again.mesh.x, part.mesh.x)
    assert (again.reference.begin, again.reference.end) == (3, 9)
    assert again.status is Status.CONVERGED
