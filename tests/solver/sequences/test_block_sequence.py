"""Meshes of blocks that follow a solution in time."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.kernels import Rule
from equimesh.rounds.norms import measured
from equimesh.testing.geometries import disc, l_shape

DOMAIN = l_shape(500)


def front(t: float) -> em.Expression:
    """A front that moves across the domain."""
    return em.Expression("tanh(12*(x + y - 0.8 - t))", t=t)


@cache
def first() -> em.Solution[em.Blocks]:
    """The solution at the first time."""
    return em.solve(em.Problem(monitor=em.LeastError(u=front(0.0)), domain=DOMAIN), threads=1)


def sequence(**settings: Any) -> em.Sequence:
    """A sequence that begins there."""
    return em.Sequence(first().problem, solution=first(), **settings)


def test_meshes_follow_a_front_and_keep_integrals() -> None:
    moving = sequence()
    mesh = moving.mesh
    values = (mesh.x > 0.6).astype(float)
    whole = em.integral(mesh, values)
    for k in (1, 2):
        before = moving.mesh
        step = moving.step(front(0.05 * k), {"rho": em.MeshValues(values, transfer="conservative"), "x": before.x})
        values = step.fields["rho"]
        assert (step.number, moving.number, moving.mesh) == (k, k, step.mesh)
        assert em.integral(step.mesh, values) == pytest.approx(whole, rel=1e-14)
        assert 0.0 <= values.min() <= values.max() <= 1.0
        assert np.abs(step.fields["x"] - step.mesh.x).max() < 1e-12
        assert np.array_equal(step.velocity, step.mesh.points - before.points)
        assert step.solution.interpolation.gain_l2 > 0.8 * first().interpolation.gain_l2
        assert 0.1 < step.moved < 20.0  # in lengths of cells, which are short across the front
        assert step.warnings[: len(step.notes)] == step.notes
    assert "2" in repr(step)


def test_values_at_the_nodes_are_followed_as_formulas_are() -> None:
    one, other = sequence(), sequence()
    t = 0.03
    by_formula = one.step(front(t))
    by_values = other.step(front(t).evaluate(other.mesh.x, other.mesh.y)[0])
    by_text = sequence().step("tanh(12*(x + y - 0.83))")
    errors = [measured(front(t), DOMAIN, step.mesh, Rule(norm="l2", points=3)) for step in (by_values, by_formula)]
    assert errors[0] < 1.5 * errors[1]
    assert by_text.mesh.distance(by_formula.mesh) < 1e-6


def test_copies_stay_one_period_apart_where_the_seam_moves() -> None:
    around: dict[str, Any] = {"vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}}
    around["blocks"] = [{"corners": ["a", "b", "c", "d"], "cells": [12, 12]}]
    domain = em.Blocks.of({**around, "joins": [{"from": ["a", "d"], "to": ["b", "c"]}]})
    wave = "tanh(6*sin(2*pi*(x - t + 0.1*sin(2*pi*y))))"
    moving = em.Sequence(em.Problem(monitor=em.LeastError(u=em.Expression(wave, t=0.0)), domain=domain))
    for k in (1, 2):
        u = em.Expression(wave, t=0.1 * k).evaluate(moving.mesh.x, moving.mesh.y)[0]
        mesh, whole = moving.mesh, em.integral(moving.mesh, u)
        step = moving.step(u, {"u": em.MeshValues(u, transfer="conservative")})
        apart = step.mesh.points[mesh.ties[:, 0]] - step.mesh.points[mesh.ties[:, 1]]
        assert np.abs(apart - [1.0, 0.0]).max() < 1e-12
        assert em.integral(step.mesh, step.fields["u"]) == pytest.approx(whole, abs=1e-13)
    assert np.abs(moving.mesh.x[mesh.ties[:, 1]]).max() > 0.01


def test_a_monitor_gives_its_settings_to_later_steps() -> None:
    moving = sequence()
    moving.step(em.LeastError(u=front(0.02), norm="h1"))
    assert moving.problem.monitor.norm == "h1"
    assert moving.step(front(0.03)).solution.problem.monitor.norm == "h1"


def test_a_share_of_the_mesh_before_stays_on_the_curves() -> None:
    domain = disc(400)
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(9*x)")), domain=domain)
    ways = [em.Sequence(problem, mesh=domain.mesh, smoothing=share) for share in (0.0, 0.5)]
    plain, smooth = (way.step("tanh(9*(x - 0.1*y))").mesh for way in ways)
    free = domain.node_curve < 0
    middle = 0.5 * (plain.points + domain.mesh.points)
    assert np.abs((smooth.points - middle)[free]).max() < 1e-12
    on = domain.node_curve >= 0
    assert np.abs(np.hypot(smooth.x, smooth.y)[on] - 1.0).max() < 1e-12
    assert "keeps a share" in ways[1].solution.note


def test_a_large_move_is_refused_where_this_is_requested() -> None:
    moving = sequence(outrun="refuse", max_move=0.5)
    with pytest.raises(em.InputError, match=r"more than max_move = 0\.5: u has outrun its cells"):
        moving.step(front(0.6))
    assert moving.number == 0
    assert moving.mesh is first().mesh


def test_what_cannot_be_used_is_refused() -> None:
    problem, moving = first().problem, sequence()
    with pytest.raises(em.InputError, match="give a Problem"):
        em.Sequence(None)  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="cannot begin with"):
        em.Sequence(problem, mesh=em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5)))
    with pytest.raises(em.InputError, match="leave the grid out"):
        moving.step(front(0.1), grid=em.Grid(n_xi=5, n_eta=5))
    with pytest.raises(em.InputError, match="give a mesh with the cells of the domain"):
        em.Sequence(problem, mesh=disc(300).mesh)
    with pytest.raises(em.InputError, match="cannot begin with"):
        em.Sequence(problem, mesh=3)
    with pytest.raises(em.InputError, match="not both"):
        em.Sequence(problem, mesh=DOMAIN.mesh, solution=first())
    for several in ({"u": front(0.0), "v": front(0.1)}, (front(0.0), front(0.1))):
        with pytest.raises(em.InputError, match="several parts"):
            moving.step(several)
    with pytest.raises(em.SamplesError, match="a value at each node is needed"):
        moving.step(np.zeros(7))
    with pytest.raises(em.SamplesError, match="rho has shape"):
        moving.step(front(0.1), {"rho": np.zeros(7)})
    nodal = em.NodalSolution(u=em.QuadField(mesh=DOMAIN.mesh, values=DOMAIN.mesh.x))
    of_values = em.Sequence(em.Problem(monitor=nodal, domain=DOMAIN), mesh=DOMAIN.mesh)
    with pytest.raises(em.InputError, match="values of a solver at the nodes"):
        of_values.step(front(0.0))
    own = em.Sequence(problem, mesh=DOMAIN.mesh.moved(DOMAIN.mesh.points.copy()))
    own.mesh.points[7] += 1e-3
    with pytest.raises(em.InputError, match="was written into"):
        own.step(front(0.1))


def test_a_failed_solve_keeps_the_mesh() -> None:
    moving = sequence(check=False)
    failed = em.Solution(problem=first().problem, mesh=first().mesh, reference=first().mesh, status=em.Status.FOLDED)
    step = moving._failed(failed, {"x": em.MeshValues(moving.mesh.x)})
    assert (step.mesh, step.moved, step.status) == (moving.mesh, 0.0, em.Status.FOLDED)
    assert np.array_equal(step.fields["x"], moving.mesh.x)
    with pytest.raises(em.SolveError):
        sequence()._failed(failed, {})
