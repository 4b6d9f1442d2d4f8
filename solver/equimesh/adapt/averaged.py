"""The next mesh of blocks for a code with unknowns in its cells, from averages over them."""

from __future__ import annotations

from equimesh.blocks.blocks import Blocks
from equimesh.equations.block_problem import BlockProblem
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.elements import Norm
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.least_error import LeastError
from equimesh.solving.solve import solve

DISTORTION = 4.0
"""The weight of distortion. Finite volumes lose their order where cells are oblique or change their sizes fast."""
SMOOTHNESS = 100.0
"""The weight of smoothness: behind a step OpenFOAM diverged on meshes of the usual weights, and gains by these."""


def averaged_mesh(u: QuadField, domain: Blocks, norm: Norm, threads: int) -> QuadMesh:
    """The next mesh of ``domain``, from ``u`` on the mesh before, with even cells. The mesh before if none is better.

    Raises as :func:`~equimesh.solving.solve.solve`.
    """
    monitor = LeastError(u=u, norm=norm, distortion=DISTORTION, smoothness=SMOOTHNESS)
    return solve(BlockProblem(monitor=monitor, domain=domain), initial=u.mesh, check=False, threads=threads).mesh
