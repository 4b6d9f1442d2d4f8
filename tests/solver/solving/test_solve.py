"""One call from a problem to a mesh: observers, starts, and fields given by samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.solving.solve import Best, Equidistribute, MinimiseError, Round, method_of
from equimesh.testing.geometries import l_shape
from solver.schwarz.runs import PAPER, assert_same


def test_observer_sees_newton_steps_and_iterations() -> None:
    seen: list[em.Event] = []
    settings = em.Schwarz(tolerance=1e-6, compare_single_domain=True)
    solution = em.solve(PAPER, settings, observe=seen.append)
    assert [e for e in seen if isinstance(e, em.Iteration)] == list(solution.iterations)
    grids = {e.grid for e in seen if isinstance(e, em.Step)}
    assert grids == {em.Grid(n_xi=13, n_eta=11), PAPER.grid}


def test_an_unknown_option_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(TypeError, match=r"solve\(\) has no option 'thread'; did you mean 'threads'\?"):
        em.solve(PAPER, thread=1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="it has initial, mode, allow_relaxed, threads, observe, check"):
        em.solve(PAPER, verbose=True)  # type: ignore[call-arg]


def test_a_spline_of_samples_gives_the_mesh_of_the_function() -> None:
    """Node positions differ by the accuracy of the spline: fourth order in the spacing of the samples."""
    case = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    exact = em.solve(case, mode=em.Mode.TIGHT).mesh
    differences = []
    for samples in (33, 65, 129):
        axis = np.linspace(0, 1, samples)
        (values,) = case.monitor.u.evaluate(*np.meshgrid(axis, axis, indexing="ij"))
        monitor = replace(case.monitor, u=em.GridSamples(x=axis, y=axis, values=values))
        mesh = em.solve(replace(case, monitor=monitor)).mesh
        differences.append(max(abs(mesh.x - exact.x).max(), abs(mesh.y - exact.y).max()))
    assert differences[0] < 2e-5
    assert differences[2] < 3e-8
    assert differences[1] / differences[2] > 8


def test_a_solve_may_start_from_a_mesh() -> None:
    """That of a front a little before, with subdomains and without; another shape, or a folded one, is refused."""
    before, now = (
        em.Problem(
            monitor=em.ArcLength(u=em.Expression("tanh(20*(x + y/2 - 0.75 - t))", t=t)), grid=em.Grid(n_xi=33, n_eta=33)
        )
        for t in (0.0, 1e-3)
    )
    start = em.solve(before, mode=em.Mode.TIGHT).reference
    cold = em.solve(now, mode=em.Mode.TIGHT)
    assert_same(em.solve(now, initial=start), cold, 1e-9)
    warm = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=start)
    assert_same(warm, cold, 1e-9)
    assert len(warm.iterations) - 1 <= 3
    far = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=em.Mesh.uniform(now.grid))
    assert_same(far, cold, 1e-9)
    assert "too far from the solution to start from" in far.message
    assert repr(far) == f"<Solution: 33 x 33 points, converged, {len(far.iterations)} iterations>"
    assert repr(cold) == "<Solution: 33 x 33 points, converged>"
    for wrong in (em.solve(PAPER).reference, em.Mesh(start.x[::-1].copy(), start.y)):
        with pytest.raises(em.InputError, match="the mesh to start from"):
            em.solve(now, initial=wrong)


def test_the_method_follows_from_the_monitor_and_has_its_own_settings() -> None:
    u, grid, settings = em.Expression("tanh(9*x)"), em.Grid(n_xi=9, n_eta=9), em.Schwarz(subdomains=(2, 1))
    mesh = em.Mesh.uniform(grid)
    nodal = em.NodalSolution(u=em.NodalField(mesh=mesh, values=mesh.x))
    tight = {"mode": "tight", "allow_relaxed": False}
    equidistribute = Equidistribute(schwarz=settings, mode=em.Mode.TIGHT, allow_relaxed=False)
    for monitor, expected in (
        (em.ArcLength(u=u), equidistribute),
        (em.Auto(u=u), Best(equidistribute=equidistribute)),
        (em.LeastError(u=u), MinimiseError(schwarz=settings)),
    ):
        assert method_of(em.Problem(monitor=monitor, grid=grid), settings, **tight) == expected
    assert method_of(em.Problem(monitor=nodal, grid=grid), **tight) == Round()
    on_blocks = em.Problem(monitor=em.Auto(u=u), domain=l_shape(100))
    assert method_of(on_blocks, em.Schwarz()) == Best(minimise=MinimiseError(schwarz=em.Schwarz()))
    with pytest.raises(em.InputError, match="leave the Schwarz settings out") as caught:
        method_of(em.Problem(monitor=nodal, grid=grid), settings)
    assert caught.value.field == "schwarz"
