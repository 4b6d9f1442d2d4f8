"""The next mesh from an error indicator of the solver on every cell."""

from __future__ import annotations

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
from equimesh_coupling.adaptation import wanted_density


def indicated_mesh(mesh: Mesh, indicator: Array, domain: Domain, norm: Norm, threads: int) -> Mesh:
    """The next mesh of ``domain`` by the ``indicator`` of the cells of ``mesh``, shape ``(n_xi - 1, n_eta - 1)``.

    Cells are wanted where the indicator is large: their density is that of the cells now, times a power of the
    indicator. A gradient map gives all cells equal shares of it. The mesh itself where the indicator is zero.
    Raises :class:`~equimesh.solving.solution.SolveError` where no valid mesh is found.
    """
    reference = reference_on(mesh, domain)
    density = wanted_density(reference.x, reference.y, indicator, norm)
    if density is None:
        return mesh
    rho = HermiteField(mesh=reference, values=density)
    monitor = Weight(rho=OnDomain(reference=rho, domain=domain), map="gradient")
    solution: Solution = solve(Problem(monitor=monitor, grid=mesh.grid, domain=domain), threads=threads)
    return solution.mesh
