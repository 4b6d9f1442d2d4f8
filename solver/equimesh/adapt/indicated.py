"""The next mesh from an error indicator of the solver on every cell."""

from __future__ import annotations

import numpy as np

from equimesh.domains.domain import Domain
from equimesh.equations.problem import Problem
from equimesh.fields.hermite_field import HermiteField
from equimesh.fields.on_domain import OnDomain
from equimesh.fields.recovered import reference_on
from equimesh.least_error.elements import Norm
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.tensor import Weight
from equimesh.numerics.types import Array
from equimesh.solving.solution import Solution
from equimesh.solving.solve import solve

POWERS = {"l2": 2.0 / 3.0, "h1": 1.0}
"""The power of an indicator by which the number of cells has to grow: it falls with the cube of the spacing in L2, with
its square for the gradient.
"""
FLOOR_SHARE = 0.1
"""The share of the mean density that is added to it everywhere: cells where the indicator is zero stay bounded."""


def indicated_mesh(mesh: Mesh, indicator: Array, domain: Domain, norm: Norm, threads: int) -> Mesh:
    """The next mesh of ``domain`` by the ``indicator`` of the cells of ``mesh``, shape ``(n_xi - 1, n_eta - 1)``.

    Cells are wanted where the indicator is large: their density is that of the cells now, times a power of the
    indicator. A gradient map gives all cells equal shares of it. The mesh itself where the indicator is zero.
    Raises :class:`~equimesh.solving.solution.SolveError` where no valid mesh is found.
    """
    reference = reference_on(mesh, domain)
    density = indicated_density(reference, indicator, norm)
    if density is None:
        return mesh
    rho = HermiteField(mesh=reference, values=density)
    monitor = Weight(rho=OnDomain(reference=rho, domain=domain), map="gradient")
    solution: Solution = solve(Problem(monitor=monitor, grid=mesh.grid, domain=domain), threads=threads)
    return solution.mesh


def indicated_density(reference: Mesh, indicator: Array, norm: Norm) -> Array | None:
    """The wanted density of cells at the nodes, with the mean 1 over the cells; ``None`` where all indicators are 0."""
    x, y = reference.x, reference.y
    area = 0.5 * (
        (x[1:, 1:] - x[:-1, :-1]) * (y[:-1, 1:] - y[1:, :-1]) - (x[:-1, 1:] - x[1:, :-1]) * (y[1:, 1:] - y[:-1, :-1])
    )
    largest = float(indicator.max())
    if not largest > 0.0:
        return None
    density = (indicator / largest) ** POWERS[norm] / area
    density /= float((density * area).sum() / area.sum())
    padded = np.pad(density, 1, mode="edge")
    nodes = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    return np.asarray((nodes + FLOOR_SHARE) / (1.0 + FLOOR_SHARE))
