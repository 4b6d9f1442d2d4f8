"""Nested iteration: the mesh of Newton's method, and the ways to it."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh.single_domain import iteration
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.sweeps.deviation import deviation
from solver.sweeps.windows import distance

# Newton steps for tanh20 on 17, 33 and 65 points a side. Blessed numbers: those of today's solver, not of theory.
# Where a change moves them, check that the meshes stay the same, and write the new ones here in the same commit, with
# the reason in its message. Each level but the coarsest must go on needing fewer steps than that.
BLESSED_NEWTON_STEPS = [8, 4, 4]


def test_newton_steps_of_the_nested_iteration() -> None:
    """Counts for tanh20: each level starts from the coarser mesh and needs fewer steps."""
    last = {record.grid.n_xi: record for record in single_domain_steps(problem("tanh20", 65), sweeps=False)}
    assert [last[n].step for n in (17, 33, 65)] == BLESSED_NEWTON_STEPS
    assert all(record.converged for record in last.values())
    assert all(0.40 < record.mesh.min_jacobian < 0.42 for record in last.values())


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_mesh_is_that_of_newton(name: str, boundary: em.Boundary) -> None:
    case = problem(name, 49, 41, boundary=boundary, b=0.1)
    *_, fast = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(case, sweeps=False)
    if reference.relaxation.is_none:
        assert fast.relaxation.is_none
        assert distance(fast.mesh, reference.mesh) < 1e-9
    assert reference.relaxation.is_none or boundary is not em.Boundary.TRACE


FLOWER = "1/(1 + exp((hypot(x-0.5, y-0.47) - 0.25 - 0.04*cos(6*atan2(y-0.47001, x-0.50001)))/0.012))"


@pytest.mark.parametrize("shape", [(65, 65), (129, 65), (40, 171)])
def test_a_mesh_is_found_on_every_shape_of_grid(shape: tuple[int, int]) -> None:
    """A bent thin front: coarse grids with few points in one direction have no mesh, square ones lead to it."""
    grid = em.Grid(n_xi=shape[0], n_eta=shape[1])
    *_, last = single_domain_steps(em.Problem(monitor=em.ArcLength(u=em.Expression(FLOWER), scaled=False), grid=grid))
    assert last.is_exact
    assert last.mesh.x.shape == shape


@pytest.mark.parametrize("u", ["tanh(100*(x - 0.37))", "tanh(100*(y - 0.37))"])
@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_fronts_along_a_coordinate_have_an_exact_mesh(
    u: str, boundary: em.Boundary, kind: type[em.ArcLength | em.Curvature]
) -> None:
    case = em.Problem(monitor=kind(u=em.Expression(u)), grid=em.Grid(n_xi=33, n_eta=33), boundary=boundary)
    *_, last = single_domain_steps(case)
    assert last.is_exact
    assert deviation(case.metric, case.boundary, last.mesh) < 1e-8
