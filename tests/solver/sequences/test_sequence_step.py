"""One step of a sequence."""

from __future__ import annotations

import equimesh as em


def test_a_step_tells_how_its_solve_ended_and_what_to_read() -> None:
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(20*(x-0.4))")), grid=em.Grid(n_xi=9, n_eta=9))
    solution = em.solve(problem, threads=1)
    step = em.SequenceStep(
        number=3,
        mesh=solution.mesh,
        solution=solution,
        fields={},
        velocity=None,
        moved=None,
        substeps=1,
        notes=("Note.",),
    )
    assert step.status is em.Status.COMPLETED
    assert step.certificate.status is step.status
    assert step.warnings == ("Note.", *solution.certificate.warnings)
    assert repr(step) == "<SequenceStep 3: 9 x 9 points, completed>"
