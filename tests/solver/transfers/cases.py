"""Exact averages over cells, and meshes that differ much."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

import equimesh as em
from equimesh.transfers.integrals import Cells


def averages(mesh: em.Mesh, function: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Averages of a function over the cells of a mesh, by 4 x 4 Gauss points."""
    cells, (points, weights) = Cells.of(mesh), np.polynomial.legendre.leggauss(4)
    x, y = cells.corners
    whole = np.zeros(x.shape[0])
    for a, of_a in zip((points + 1) / 2, weights / 2, strict=True):
        for b, of_b in zip((points + 1) / 2, weights / 2, strict=True):
            shape = np.array([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
            along, across = np.array([b - 1, 1 - b, b, -b]), np.array([a - 1, -a, a, 1 - a])
            jacobian = (x @ along) * (y @ across) - (x @ across) * (y @ along)
            whole += of_a * of_b * jacobian * function(x @ shape, y @ shape)
    return (whole / cells.area).reshape(mesh.cell_shape)


@cache
def adapted(u: str, n: int = 17, domain: em.Domain | None = None) -> em.Mesh:
    """A least-error mesh."""
    monitor = em.LeastError(u=em.Expression(u))
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n), domain=domain or em.Rectangle())
    return em.solve(problem, threads=1).mesh


def fronts() -> tuple[em.Mesh, em.Mesh]:
    """Two meshes of the unit square with small cells in different places."""
    return adapted("tanh(30*(x + y/2 - 0.75))"), adapted("tanh(60*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))")
