"""The solve of one step, where u has outrun its cells."""

from __future__ import annotations

import math
from typing import Any

import equimesh as em
from equimesh.sequences.pursuit import Pursuit, gain_of
from equimesh.testing.geometries import l_shape

FRONT = "tanh(30*(x + y/2 - 0.6 - t))"
GRID = em.Grid(n_xi=17, n_eta=17)


def problem(t: float, kind: Any = em.LeastError) -> em.Problem:
    return em.Problem(monitor=kind(u=em.Expression(FRONT, t=t)), grid=GRID)


def pursuit(start: em.Solution, **changes: Any) -> Pursuit:
    known: dict[str, Any] = {"u": start.problem.monitor.u, "gain": gain_of(start), "max_move": 1.0}
    known["options"] = {"threads": 1}
    return Pursuit(schwarz=None, before=start.reference, **{**known, **changes})


def test_a_front_that_jumps_is_found_by_another_start() -> None:
    start = em.solve(problem(0.0), threads=1)
    far = pursuit(start).solve(problem(0.15))
    direct = em.solve(problem(0.15), initial=start.reference, threads=1)
    assert far.gain >= gain_of(direct)
    assert far.gain > 0.5 * gain_of(start)
    assert far.substeps == 1


def test_the_mesh_before_is_enough_for_a_small_move() -> None:
    start = em.solve(problem(0.0), threads=1)
    near = pursuit(start, gain=1.0, max_move=math.inf).solve(problem(0.001))
    assert near.gain == gain_of(em.solve(problem(0.001), initial=start.reference, threads=1))


def test_a_mesh_that_has_kept_its_gain_stays_near_however_far_it_moved() -> None:
    start = em.solve(problem(0.0), threads=1)
    near = pursuit(start, gain=1.0, max_move=1e-6).solve(problem(0.02))
    direct = em.solve(problem(0.02), initial=start.reference, threads=1)
    assert near.solution.mesh.distance(direct.mesh) == 0.0
    grids = {}
    for gain in (1.0, math.nan):
        seen: list[Any] = []
        pursuit(start, gain=gain, max_move=1e-6, options={"threads": 1, "observe": seen.append}).solve(problem(0.02))
        grids[gain] = sum(event.grid == GRID and event.step == 0 for event in seen)
    assert grids[1.0] == 1
    assert sum(grids.values()) > 2  # where the gain is not known, a nested start is tried, too


def test_substeps_are_taken_where_the_error_stays_large() -> None:
    seen: list[Any] = []
    start = em.solve(problem(0.0), threads=1)
    options: em.solving.options.SolveArguments = {"threads": 1, "observe": lambda event: seen.append(event)}
    chase = Pursuit(
        schwarz=None, options=options, before=start.reference, u=start.problem.monitor.u, gain=1e9, max_move=2.0
    )
    found = chase.solve(problem(0.1))
    finest = [event for event in seen if event.grid == GRID and event.step == 0]
    assert len(finest) > 4
    assert found.gain >= gain_of(em.solve(problem(0.1), threads=1)) * (1 - 1e-12)


def test_a_monitor_without_u_has_no_gain() -> None:
    solution = em.solve(em.Problem(monitor=em.Weight(rho=em.Expression("1 + x")), grid=GRID), threads=1)
    assert math.isnan(gain_of(solution))
    found = pursuit(solution, max_move=1e-9).solve(
        em.Problem(monitor=em.Weight(rho=em.Expression("1 + 3*y")), grid=GRID)
    )
    assert found.solution.status.succeeded


def test_on_blocks_the_same_starts_are_tried() -> None:
    domain = l_shape(300)

    def on_blocks(t: float) -> em.Problem[em.Blocks]:
        return em.Problem(monitor=em.LeastError(u=em.Expression("tanh(12*(x + y - 0.8 - t))", t=t)), domain=domain)

    start = em.solve(on_blocks(0.0), threads=1)
    known: dict[str, Any] = {"options": {"threads": 1}, "before": start.mesh, "u": start.problem.monitor.u}
    near = Pursuit(**known, gain=1.0, max_move=9.0).solve(on_blocks(0.02))
    assert near.solution.mesh.distance(em.solve(on_blocks(0.02), initial=start.mesh, threads=1).mesh) == 0.0
    far = Pursuit(**known, gain=1e9, max_move=0.5).solve(on_blocks(0.4))
    assert far.gain >= gain_of(em.solve(on_blocks(0.4), threads=1))
