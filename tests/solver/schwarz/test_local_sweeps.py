"""Sweeps on the window of one subdomain: interfaces stay, and the interior goes where Newton's method puts it."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps
from equimesh.schwarz.functionals import SubdomainProblem
from equimesh.schwarz.subdomains import SubdomainSweeps
from equimesh.sweeps.sweep import Frame
from solver.schwarz.neighbours import SameMesh

CASE = problem("paper", 20, 17)
BLOCKS = em.Decomposition(grid=CASE.grid, subdomains=(3, 2), overlap=3)


def sweeps_on(part: SubdomainProblem) -> SubdomainSweeps:
    return SubdomainSweeps(CASE, part.window.shape, Frame(physical=part.window.physical))


@pytest.mark.parametrize("number", range(6))
def test_held_interfaces_stay_and_the_rest_solves_the_equations(number: int) -> None:
    part = SubdomainProblem(CASE, BLOCKS, BLOCKS.parts[number], em.Classical())
    mesh = em.solve(problem("paper", 20, 17, a=0.6)).reference  # near the solution, and none
    start = part.window.restrict(mesh)
    swept = sweeps_on(part).solve(part.window.restrict(mesh), None, accuracy=1e-13, most=200)
    assert swept.converged
    *_, newton = newton_steps(part.equations(SameMesh([part], mesh)), start, most_steps=20)
    assert newton.converged
    assert swept.mesh.x == pytest.approx(newton.mesh.x, abs=1e-10)
    assert swept.mesh.y == pytest.approx(newton.mesh.y, abs=1e-10)
    for (axis, end), is_open in part.window.open.items():
        if is_open:
            rim = (-1 if end else 0) if axis == 0 else (slice(None), -1 if end else 0)
            assert np.array_equal(swept.mesh.x[rim], start.x[rim])
    assert abs(swept.mesh.x - start.x).max() > 1e-3


def test_sweeps_end_at_what_is_enough() -> None:
    part = SubdomainProblem(CASE, BLOCKS, BLOCKS.parts[0], em.Classical())
    mesh = em.solve(problem("paper", 20, 17, a=0.6)).reference

    def steps(**ends: float) -> int:
        return sweeps_on(part).solve(part.window.restrict(mesh), None, **({"accuracy": 1e-12, "most": 90} | ends)).steps

    few, many = steps(enough=1e-4), steps()
    assert few < steps(accuracy=1e-5) < many < 90
    assert [steps(most=most) for most in (1, 2)] == [1, 2]


def test_a_mesh_that_is_no_number_is_no_solution() -> None:
    part = SubdomainProblem(CASE, BLOCKS, BLOCKS.parts[0], em.Classical())
    start = part.window.restrict(em.Mesh.uniform(CASE.grid))
    start.x[2, 2] = np.nan
    assert not sweeps_on(part).solve(start, None, accuracy=1e-8, most=9).converged
