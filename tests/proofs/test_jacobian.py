"""Jacobian: the Taylor remainder of every equation falls at second order in the perturbation."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import MeshEquations
from equimesh.schwarz.functionals import CornerLink, InterfaceData, Link, SubdomainProblem
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.optimized import OptimizedSubdomains

STEPS = (1e-3, 5e-4, 2.5e-4)


def check_taylor_remainder(equations: MeshEquations, mesh: em.Mesh) -> None:
    """The remainder of the linearisation falls by 4 when the step is halved, and the derivative is not small."""
    random = np.random.default_rng(7)
    z = equations.vector(mesh) + 0.02 * random.standard_normal(2 * equations.size)
    v = random.standard_normal(z.size)
    value, slope = equations.residual(z), equations.jacobian(z) @ v
    remainders = [np.linalg.norm(equations.residual(z + h * v) - value - h * slope) for h in STEPS]
    assert np.linalg.norm(slope) > 1.0
    for coarse, fine in pairwise(remainders):
        assert 3.9 < coarse / fine < 4.1


class OldNeighbours:
    """Neighbours that send the values of a fixed mesh."""

    def __init__(self, part: SubdomainProblem, mesh: em.Mesh) -> None:
        self.part, self.mesh = part, mesh

    def functional(self, link: Link) -> InterfaceData:
        return self.part.functional(self.part.window.restrict(self.mesh), link)

    def node(self, link: CornerLink) -> tuple[float, float]:
        return self.part.node(self.part.window.restrict(self.mesh), link)


@pytest.mark.parametrize(
    "condition", [em.Classical(), em.LinearRobin(), em.NonlinearRobin(p=3.0)], ids=lambda c: c.name
)
@pytest.mark.parametrize("number", range(9))
def test_subdomain_with_interfaces_on_every_side(condition: em.TransmissionCondition, number: int) -> None:
    case = problem("tanh20", 18, 15)
    mesh = em.Mesh.uniform(case.grid)
    decomposition = em.Decomposition(grid=case.grid, subdomains=(3, 3), overlap=2)
    part = SubdomainProblem(case, decomposition, decomposition.parts[number], condition)
    equations = part.equations(OldNeighbours(part, mesh))
    state = part.window.restrict(mesh)
    check_taylor_remainder(equations, state)
    # Square and consistent: as many equations as unknowns, each unknown with a row of its own.
    matrix = equations.jacobian(equations.vector(state))
    assert np.count_nonzero(np.diff(matrix.tocsr().indptr)) == 2 * equations.size
    # What the neighbours send is what the subdomain has: the interface rows vanish, not only the others.
    rows = np.concatenate([c.rows(equations.window(equations.vector(state))).rows for c in equations.conditions])
    interior = np.zeros(2 * equations.size, dtype=bool)
    interior[rows] = True
    assert interior.sum() == 2 * (equations.size - (equations.shape[0] - 2) * (equations.shape[1] - 2))
    assert abs(equations.residual(equations.vector(state))[interior_interface_rows(equations, state)]).max() < 1e-12


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("parts", [(3, 1), (1, 2), (3, 3)], ids=str)
def test_subdomains_whose_interfaces_yield(boundary: em.Boundary, parts: tuple[int, int]) -> None:
    case = problem("tanh20", 18, 15, boundary=boundary)
    decomposition = em.Decomposition(grid=case.grid, subdomains=parts, overlap=2)
    subdomains = OptimizedSubdomains(
        case, MergedMeshes(decomposition), em.Optimized(), em.LocalSolver.NEWTON, in_turns=False, enough=0.0, threads=1
    )
    mesh = em.Mesh.uniform(case.grid)
    subdomains.begin(mesh)
    for k, window in enumerate(subdomains.windows):
        equations, state = subdomains.equations(k), window.restrict(mesh)
        check_taylor_remainder(equations, state)
        matrix = equations.jacobian(equations.vector(state))
        assert np.count_nonzero(np.diff(matrix.tocsr().indptr)) == 2 * equations.size


def interior_interface_rows(equations: MeshEquations, state: em.Mesh) -> list[int]:
    """Rows of the interface conditions alone."""
    window = equations.window(equations.vector(state))
    interfaces = [c for c in equations.conditions if type(c).__name__.startswith("Interface")]
    assert interfaces
    return [int(r) for c in interfaces for r in c.rows(window).rows]


def test_the_nonlinear_functional_is_the_metric_length_to_second_order() -> None:
    """S1 on an interface line against its exact value, at the two ends of the line as well."""
    errors = []
    for n in (17, 33):
        case = problem("sine", n)
        xi, eta = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
        x, y = xi + 0.1 * np.sin(3 * xi + eta), eta + 0.1 * np.sin(2 * eta + xi)
        x_xi, y_xi = 1 + 0.3 * np.cos(3 * xi + eta), 0.1 * np.cos(2 * eta + xi)
        m11, m12, m22 = case.monitor.metric(x, y)
        exact = np.sqrt(m11 * x_xi**2 + 2 * m12 * x_xi * y_xi + m22 * y_xi**2)
        equations, line = case.equations(), n // 2
        window = equations.window(equations.vector(em.Mesh(x, y)))
        values = em.NonlinearRobin().normal(window, line, 2.2).values - 2.2 * x[line]
        errors.append(np.abs(values - exact[line])[[0, n // 2, -1]])
    orders = np.log2(errors[0] / errors[1])
    assert np.all(orders > 1.7), orders
