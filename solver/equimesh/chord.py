"""The chord iteration: line corrections in place of Newton's sparse factorisation.

The equations are two families of one-dimensional problems, coupled through the metric. To leading order the squared
metric length of a xi-edge depends on the nodes through ``P = A dx + B dy`` alone, ``(A, B) = M r_xi``, and that of an
eta-edge through ``Q = C dx + D dy``, ``(C, D) = M r_eta``: equal lengths along a line ask for a P that is a running sum
of the line's defects, and a Q likewise; the nodes follow from a 2 x 2 system each, whose determinant ``det(M) J`` is
positive on a valid mesh. The error falls by a factor that does not depend on the number of points.

The sides are one-dimensional problems of their own, and are solved first. The iteration is local: it wants a start near
the solution, from a coarser grid, and says so when it has none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from equimesh import kernels
from equimesh.boundary import Boundary, sides
from equimesh.mesh import Mesh
from equimesh.problem import Problem

TOLERANCE = 1e-10
MOST_SWEEPS = 60
# A sweep that does not lower the deviation by this factor, so many times in a row, ends the iteration.
SLOWEST, MOST_SLOW = 0.95, 4


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """The state after ``sweep`` sweeps.

    ``deviation`` is the largest relative difference of a squared metric length from the mean of its line. The last
    record has ``converged`` set, or ``failed``: the next sweep would fold the mesh, or the deviation no longer falls.
    """

    sweep: int
    mesh: Mesh
    deviation: float
    converged: bool = False
    failed: bool = False


def iterate(problem: Problem, start: Mesh) -> Iterator[Sweep]:
    """Sweeps from ``start``, which must be near the solution, until the deviation is at most 1e-10.

    Yields nothing where the sides are no problems of their own (the ``orthogonal`` condition), or have no solution.
    """
    mesh = _with_sides(problem, start)
    if mesh is None or mesh.is_folded:
        return
    x, y, monitor = mesh.x, mesh.y, problem.monitor
    new_x, new_y = x.copy(), y.copy()
    along_xi, along_eta, inverse = np.empty_like(x[1:]), np.empty((x.shape[0], x.shape[1] - 1)), np.empty((4, *x.shape))
    best, slow = np.inf, 0
    for sweep in range(MOST_SWEEPS):
        (u,) = monitor.u.evaluate(x, y)
        kernels.squared_lengths(x, y, u, monitor.a**2, monitor.b, along_xi, along_eta)
        kernels.inverse_matrices(x, y, u, monitor.a**2, monitor.b, inverse)
        deviation = kernels.move_nodes(x, y, along_xi, along_eta, inverse, new_x, new_y)
        slow = 0 if deviation < SLOWEST * best else slow + 1
        best = min(best, deviation)
        converged = deviation <= TOLERANCE
        failed = not converged and (slow > MOST_SLOW or not kernels.smallest_jacobian(new_x, new_y) > 0)
        yield Sweep(sweep=sweep, mesh=Mesh(x.copy(), y.copy()), deviation=deviation, converged=converged, failed=failed)
        if converged or failed:
            return
        x, new_x, y, new_y = new_x, x, new_y, y


def _with_sides(problem: Problem, start: Mesh) -> Mesh | None:
    if problem.boundary is Boundary.ORTHOGONAL:
        return None
    coordinates = (start.x.copy(), start.y.copy())
    for side in sides(problem.boundary).values():
        line = side.line(coordinates[1 - side.axis])
        placed = side.place(problem.monitor, line.copy())
        if placed is None:
            return None
        line[:] = placed
    return Mesh(*coordinates)
