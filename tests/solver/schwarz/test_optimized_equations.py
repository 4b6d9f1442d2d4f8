"""The equations of subdomains with the optimized condition: Newton's method finds what their sweeps converge to."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.subdomains import SubdomainSweeps
from solver.schwarz.bent import bent, distance, yielding_subdomains

SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))


def check_against_sweeps(case: em.Problem, parts: tuple[int, int], data: em.LineData = em.LineData.LINE_SUMS) -> None:
    """Newton's method finds what sweeps without end converge to, in every subdomain."""
    decomposition = em.Decomposition(grid=case.grid, subdomains=parts, overlap=3)
    mesh = bent(case, 0.01)
    found = yielding_subdomains(case, decomposition, em.Optimized(data=data))
    found.begin(mesh)
    for k, window in enumerate(found.windows):
        start, sides = found.received(k)
        sweeps = SubdomainSweeps(case, window.shape, window.frame(case.grid.shape))
        swept = sweeps.solve(window.restrict(mesh), sides.rest, accuracy=1e-14, most=400)
        newton = found.solve(k).solution
        assert newton.converged
        assert not newton.swept
        assert distance(newton.mesh, swept.mesh) < 1e-10
        assert distance(newton.mesh, start) > 1e-3


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("parts", [(3, 1), (1, 3), (3, 3)], ids=str)
def test_newton_finds_what_sweeps_converge_to(boundary: em.Boundary, parts: tuple[int, int]) -> None:
    check_against_sweeps(problem("paper", 18, 15, boundary=boundary), parts)


@pytest.mark.parametrize("data", em.LineData)
def test_newton_finds_what_sweeps_converge_to_on_a_domain(data: em.LineData) -> None:
    monitor = em.Weight(rho=em.Expression("1 + 2*exp(-10*((x - 0.4)**2 + (y - 0.6)**2))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=15, n_eta=18), domain=SECTOR)
    check_against_sweeps(case, (3, 3), data)
