"""All sweeps of a level in few calls: meshes and records are those of sweeps one by one, to the last bit."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array
from equimesh.single_domain import iteration, level
from equimesh.sweeps.one_strip import MAX_SWEEPS_AT_ONCE, NOT_GIVEN, Patches, is_one_strip

Found: TypeAlias = list[tuple[object, ...]]


class Saddle:
    """A function of a user, whose code is not compiled."""

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        u = x * y + np.sin(3 * x)
        return (u,) if order == 0 else (u, y + 3 * np.cos(3 * x), x + 0.0 * y)


def samples(points: int = 65, steepness: float = 20.0) -> em.GridSamples:
    line = np.linspace(0.0, 1.0, points)
    return em.GridSamples(x=line, y=line, values=np.tanh(steepness * (np.add.outer(line, line / 2) - 0.75)))


def arc_length(u: em.Field, n_xi: int, n_eta: int, domain: em.Domain | None = None, **options: str) -> em.Problem:
    boundary = em.Boundary(options.get("boundary", "trace"))
    monitor, grid = em.ArcLength(u=u), em.Grid(n_xi=n_xi, n_eta=n_eta)
    return em.Problem(monitor=monitor, grid=grid, boundary=boundary, domain=domain or em.Rectangle())


STEEP = em.Expression("tanh(200*(x - y))")
CASES = {
    "samples": arc_length(samples(), 65, 65),
    "few nodes": arc_length(samples(), 20, 24),
    "no common nodes": arc_length(samples(), 50, 70),
    "many samples": arc_length(samples(200), 33, 33),
    "formula": problem("ring", 65),
    "long": problem("tanh20", 20, 90),
    "halved moves": arc_length(samples(129, 60.0), 33, 33),
    "lost": arc_length(STEEP, 33, 33),
    "flat sides": arc_length(samples(), 33, 40, boundary="equidistributed_1d"),
    "domain": arc_length(em.Expression("sin(3*x)*y"), 33, 33, em.Rectangle(x=(0, 2), y=(-1, 1))),
    "own code": arc_length(Saddle(), 40, 40),
    "metric of points": em.Problem(monitor=em.Curvature(u=STEEP), grid=em.Grid(n_xi=20, n_eta=20)),
}


def found(case: em.Problem, mode: em.Mode) -> Found:
    """The numbers and the meshes of all steps."""
    steps = []
    for step in iteration.single_domain_steps(case, mode=mode):
        numbers = (step.residual, step.algebraic_error, step.discretization_error, step.contraction)
        mesh = step.snapshot().mesh
        steps.append((step.level, step.step, step.converged, *map(str, numbers), mesh.x.tobytes(), mesh.y.tobytes()))
    return steps


@pytest.mark.parametrize("mode", em.Mode)
@pytest.mark.parametrize("name", CASES)
def test_steps_are_those_of_sweeps_one_by_one(name: str, mode: em.Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    here = found(CASES[name], mode)
    monkeypatch.setattr(level, "is_one_strip", lambda *_: False)
    there = found(CASES[name], mode)
    assert [step[:7] for step in here] == [step[:7] for step in there]
    assert here == there


def test_a_spline_is_evaluated_inside() -> None:
    assert Patches.of(CASES["samples"].metric).given
    assert Patches.of(CASES["many samples"].metric) is NOT_GIVEN, "its polynomials would not stay in the cache"
    assert Patches.of(CASES["formula"].metric) is NOT_GIVEN


def test_every_step_has_its_own_mesh() -> None:
    """An observer may hear of several sweeps at a time."""
    meshes = [step.snapshot().mesh for step in iteration.single_domain_steps(CASES["halved moves"])]
    assert len(meshes) > 2 * MAX_SWEEPS_AT_ONCE
    assert len({mesh.x.tobytes() for mesh in meshes}) >= len(meshes) - 4, "the last steps of levels may be at rest"


def test_larger_grids_and_orthogonal_sides_are_swept_one_by_one() -> None:
    case = CASES["samples"]
    assert is_one_strip(case, Rows.whole((181, 181)))
    assert not is_one_strip(case, Rows.whole((257, 257)))
    orthogonal = arc_length(samples(), 33, 33, boundary="orthogonal")
    assert not is_one_strip(orthogonal, Rows.whole((33, 33)))


def test_nodes_that_are_nowhere_end_the_sweeps() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 1, 17), indexing="ij")
    x[3, 4] = np.nan
    case = arc_length(samples(), 17, 17)
    *_, last = iteration.steps_from(case, em.Mesh(x, y))
    assert last.converged
    assert not last.mesh.is_folded
