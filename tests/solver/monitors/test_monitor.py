"""What every monitor promises: a positive definite metric, binding to a domain, pickling, and a mesh without units."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

import equimesh as em
from cases import FUNCTIONS
from solver.monitors.metrics import SECTOR, UNIT, every, matrices, monitors, points


@every
@pytest.mark.parametrize("domain", [UNIT, SECTOR], ids=["square", "sector"])
def test_every_metric_is_positive_definite_and_keeps_the_shape_of_the_points(name: str, domain: em.Domain) -> None:
    monitor = monitors()[name].on(domain)
    x, y = points(domain, 64)
    metric = monitor.metric(x, y)
    assert all(entry.shape == x.shape for entry in metric)
    assert np.linalg.eigvalsh(matrices(metric)).min() > 1e-3
    strided = monitor.metric(x[::3, ::2], y[::3, ::2])
    assert matrices(strided) == pytest.approx(matrices(metric)[::3, ::2], rel=1e-12)


@every
def test_binding_again_to_the_same_domain_costs_nothing(name: str) -> None:
    bound = monitors()[name].on(UNIT)
    assert bound.on(em.Rectangle()) is bound
    weak = bound.weakened(0.5)
    assert weak.on(UNIT) is weak


@every
def test_a_bound_monitor_can_be_pickled(name: str) -> None:
    monitor, (x, y) = monitors()[name].on(UNIT), points(n=9)
    copy = pickle.loads(pickle.dumps(monitor))
    assert np.array_equal(matrices(copy.metric(x, y)), matrices(monitor.metric(x, y)))


# The mesh does not depend on the units of u and of the coordinates, for any kind of monitor.

FRONT, BEND = "tanh(20*(x/w - (y/w)**2))", "tanh(5*(x/w - (y/w)**2))"
HUMP = "1 + 10*exp(-50*((x/w - 0.5)**2 + (y/w - 0.4)**2))"
UNITS = ((1e-8, 1.0), (1e8, 1.0), (1.0, 1e-3), (1.0, 1e3), (1e8, 1e-3))  # of u, and of the coordinates
TIGHT = 1e-11
"""Of the square: rounding of the nodes of a mesh that is solved to rounding."""
NEAR = 1e-9
"""Of the square: moves of sweeps that end before, which are computed in single precision."""


def scaled(formula: str, unit: float, width: float) -> em.Expression:
    return em.Expression(f"{unit!r}*({formula})".replace("w", repr(width)))


def samples(unit: float, width: float) -> em.GridSamples:
    line = np.linspace(0.0, 1.0, 129)
    values = unit * np.tanh(10 * (line[:, None] - line[None, :] ** 2))
    return em.GridSamples(x=width * line, y=width * line, values=values, box=((0, width), (0, width)))


def arc(unit: float, width: float) -> em.Monitor:
    return em.ArcLength(u=scaled(FRONT, unit, width))


def bend(unit: float, width: float) -> em.Monitor:
    return em.Curvature(u=scaled(BEND, unit, width))


def tensor(unit: float, width: float) -> em.Monitor:
    entries = {"m11": "2 + sin(3*x/w)", "m12": "x/w/3", "m22": "2 + x/w"}
    return em.Tensor(**{name: scaled(formula, unit, width) for name, formula in entries.items()})


KINDS: dict[str, Callable[[float, float], em.Monitor]] = {
    "arc_length": arc,
    "arc_length, relaxed": lambda c, w: em.ArcLength(u=scaled("tanh(100*(x/w - (y/w)**2))", c, w)),
    "arc_length of samples": lambda c, w: em.ArcLength(u=samples(c, w)),
    "curvature": bend,
    "curvature, h1": lambda c, w: em.Curvature(u=scaled(BEND, c, w), norm="h1"),
    "curvature, isotropic": lambda c, w: em.Curvature(u=scaled(BEND, c, w), isotropic=True),
    "curvature of samples": lambda c, w: em.Curvature(u=samples(c, w)),
    "weight": lambda c, w: em.Weight(rho=scaled(HUMP, c, w)),
    "weight, gradient map": lambda c, w: em.Weight(rho=scaled(HUMP, c, w), map="gradient"),
    "tensor": tensor,
    "intersection": lambda c, w: em.Intersection(monitors=(arc(c, w), bend(c, w))),
    "smoothed": lambda c, w: em.Smoothed(monitor=arc(c, w), radius=0.05),
    "smoothed curvature": lambda c, w: em.Smoothed(monitor=bend(c, w), radius=0.02),
}


def solved(kind: str, unit: float, width: float, mode: em.Mode) -> em.Solution:
    domain = em.Rectangle(x=(0.0, width), y=(0.0, width))
    problem = em.Problem(monitor=KINDS[kind](unit, width), grid=em.Grid(n_xi=17, n_eta=21), domain=domain)
    return em.solve(problem, mode=mode, threads=1)


def apart(one: em.Solution, other: em.Solution) -> float:
    first, second = one.reference, other.reference
    return max(float(np.abs(first.x - second.x).max()), float(np.abs(first.y - second.y).max()))


@pytest.mark.parametrize("kind", KINDS)
def test_units_do_not_change_the_mesh(kind: str) -> None:
    for mode, near, units in ((em.Mode.TIGHT, TIGHT, UNITS), (em.Mode.DISCRETIZATION, NEAR, UNITS[-1:])):
        one = solved(kind, 1.0, 1.0, mode)
        assert np.abs(one.reference.x - em.Mesh.uniform(one.problem.grid).x).max() > 0.01
        for unit, width in units:
            other = solved(kind, unit, width, mode)
            assert (other.status, other.relaxed) == (one.status, one.relaxed), (unit, width)
            assert apart(one, other) < near, (unit, width, mode)
            if one.interpolation is not None and other.interpolation is not None:
                assert other.interpolation.gain_l2 == pytest.approx(one.interpolation.gain_l2, rel=1e-7)


def test_without_scaling_the_units_count() -> None:
    problem = em.Problem(
        monitor=em.ArcLength(u=scaled(FRONT, 1e-8, 1.0), scaled=False), grid=em.Grid(n_xi=17, n_eta=17)
    )
    assert np.abs(em.solve(problem).mesh.x - em.Mesh.uniform(problem.grid).x).max() < 1e-9


def test_a_shift_of_u_does_not_change_the_mesh() -> None:
    one, other = (
        em.solve(
            em.Problem(monitor=em.ArcLength(u=em.Expression(f"{shift}+sin(3*x*y)")), grid=em.Grid(n_xi=17, n_eta=17))
        )
        for shift in (0, 1000)
    )
    assert apart(one, other) < NEAR


def test_the_mesh_of_the_paper_is_the_same_with_and_without_scaling() -> None:
    def mesh(scaled: bool) -> em.Solution:
        u, grid = em.Expression(FUNCTIONS["paper"]), em.Grid(n_xi=33, n_eta=33)
        return em.solve(em.Problem(monitor=em.ArcLength(u=u, scaled=scaled), grid=grid), mode=em.Mode.TIGHT)

    one, other = mesh(True), mesh(False)
    assert 0.0 < apart(one, other) < 1e-6
    assert one.quality.q_eq.max == pytest.approx(other.quality.q_eq.max, abs=1e-5)
