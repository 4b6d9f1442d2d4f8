"""Sweeps on one level: in a number that does not grow with the points, to the accuracy that the mode names."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh.single_domain import iteration
from equimesh.single_domain.level import TIGHT_DEVIATION
from equimesh.sweeps.sweep import ALGEBRAIC_SHARE
from solver.sweeps.windows import distance


def test_it_converges_on_all_functions_with_the_trace_condition() -> None:
    for name in FUNCTIONS:
        *_, last = iteration.single_domain_steps(problem(name, 65))
        assert last.converged
        assert last.residual < TIGHT_DEVIATION, "the finest level was not solved by sweeps to their tolerance"
        assert last.algebraic_error > 0.0, "sweeps, not Newton steps"


# Sweeps for tanh20 by points a side. Blessed numbers: those of today's solver, not of theory. Where a change moves
# them, check that meshes are as accurate as before, and write the new ones here in the commit that explains the change.
BLESSED_SWEEPS = {17: 9, 33: 2, 65: 2, 129: 2, 257: 1}


def test_sweeps_do_not_grow_with_the_number_of_points() -> None:
    case = problem("tanh20", 257)
    tight = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case)}
    assert tight[257] <= 11
    usual = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)}
    assert usual == BLESSED_SWEEPS


@pytest.mark.parametrize("name", ["tanh20", "paper", "ring", "wave"])
def test_the_usual_mode_leaves_a_fifth_of_the_discretisation_error(name: str) -> None:
    """Both errors against meshes that know better: the tight one of the same grid, and the tight one of a finer."""
    case, finer = problem(name, 129), problem(name, 513)
    *_, usual = iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)
    *_, tight = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(finer)
    exact = em.Mesh(reference.mesh.x[::4, ::4], reference.mesh.y[::4, ::4])
    algebraic, discretization = distance(usual.mesh, tight.mesh), distance(tight.mesh, exact)
    assert algebraic <= ALGEBRAIC_SHARE * discretization
    assert usual.discretization_error == pytest.approx(discretization, rel=0.5)
    assert algebraic > 0.0, "the tight mode would have been no dearer"
