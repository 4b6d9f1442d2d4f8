"""What every monitor promises: a positive definite metric, binding to a domain, pickling, and a mesh without units."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh as em
from cases import FUNCTIONS
from equimesh.monitors import monitor as probe_module
from equimesh.monitors.monitor import Monitor, Probe, bound_copy, intersection, is_bound_to, power
from equimesh.testing.geometries import disc
from solver.monitors.metrics import SECTOR, STEEP, UNIT, WAVE, every, matrices, monitors, points, triple


@every
def test_binding_again_to_the_same_domain_costs_nothing(name: str) -> None:
    bound = monitors()[name].on(UNIT)
    assert bound.on(em.Rectangle()) is bound
    weak = bound.weakened(0.5)
    assert weak.on(UNIT) is weak


# The mesh does not depend on the units of u and of the coordinates, for any kind of monitor.

FRONT, BEND = "tanh(20*(x/w - (y/w)**2))", "tanh(5*(x/w - (y/w)**2))"
HUMP = "1 + 10*exp(-50*((x/w - 0.5)**2 + (y/w - 0.4)**2))"
UNITS = ((1e-8, 1e3), (1e8, 1e-3))  # of u, and of the coordinates
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


# Points all over a domain: what they stand for, and what is named where a function is not finite.


def test_shares_are_those_of_the_area() -> None:
    """The mean of x over a quarter of an annulus is (8 - 1) / 3 over its area 3 pi / 4."""
    probe = Probe.of(em.AnnulusSector())
    assert probe.x.shape == probe.shares.shape == (256 * 256,)
    assert probe.shares.sum() == pytest.approx(1.0)
    assert (probe.shares * probe.x).sum() == pytest.approx(7 / 3 / (3 * np.pi / 4), rel=1e-4)
    assert probe.diameter == 2.0


def test_cells_of_blocks_are_probed_evenly_where_they_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = disc(800)
    every = Probe.of(domain)
    monkeypatch.setattr(probe_module, "MAX_CELLS", 144)
    some = Probe.of(domain)
    assert every.x.size == len(domain.mesh.cells)
    assert len(domain.mesh.cells) / 144 > 5
    assert 100 < some.x.size <= 144
    for probe in (every, some):
        assert probe.shares.sum() == pytest.approx(1.0)
        # The mean of the squared distance from the centre of the unit disc is 1/2.
        assert (probe.shares * (probe.x**2 + probe.y**2)).sum() == pytest.approx(0.5, abs=0.03)


def test_the_closure_holds_the_corners() -> None:
    probe = Probe.of_closure(em.Rectangle(x=(2, 5), y=(-1, 1)), cells=4)
    assert {*zip(probe.x, probe.y, strict=True)} >= {(2, -1), (2, 1), (5, -1), (5, 1)}
    assert probe.shares == pytest.approx(np.full(25, 1 / 25))
    assert probe.diameter == 3.0
    inner = Probe.of(em.Rectangle(x=(2, 5), y=(-1, 1)), cells=4)
    assert (inner.x.min(), inner.y.max()) == (2.375, 0.75)


def test_the_first_point_that_is_not_finite_is_named() -> None:
    probe = Probe.of_closure(UNIT, cells=2)
    fine, bad = np.ones(9), np.ones(9)
    probe.require_finite([fine, bad], "u is", field="u")
    bad[5] = np.nan
    fine[7] = np.inf
    with pytest.raises(em.InputError, match=r"u is not finite at \(x, y\) = \(0\.5, 1\)") as caught:
        probe.require_finite([fine, bad], "u is", field="rho")
    assert caught.value.field == "rho"


def test_a_bound_copy_remembers_its_domain() -> None:
    monitor = em.Curvature(u=STEEP)
    copy = bound_copy(monitor, SECTOR, alpha=3.0)
    assert (copy.alpha, monitor.alpha) == (3.0, None)
    assert is_bound_to(copy._domain, SECTOR)
    assert is_bound_to(em.Rectangle(), UNIT)
    assert not is_bound_to(None, UNIT)
    assert not is_bound_to(copy._domain, UNIT)


# Smoothed monitors: the mean with a Gaussian, positive definite, without kinks.


@pytest.mark.parametrize(
    ("domain", "radius"),
    [(UNIT, 1e-4), (SECTOR, 0.25), (em.Rectangle(x=(0.0, 40.0)), 1e-4)],
    ids=["square", "sector", "long"],
)
def test_a_smoothed_constant_is_the_constant(domain: em.Domain, radius: float) -> None:
    tensor = em.Tensor(m11=em.Expression("2"), m12=em.Expression("0.5"), m22=em.Expression("7"))
    smoothed = em.Smoothed(monitor=tensor, radius=radius).on(domain)
    for got, expected in zip(smoothed.metric(*points(domain)), (2.0, 0.5, 7.0), strict=True):
        assert got == pytest.approx(np.full(got.shape, expected), rel=1e-12)


def test_smoothing_is_the_mean_with_a_gaussian() -> None:
    # exp(k x) averaged with a Gaussian of deviation r is exp(k x + (k r)^2 / 2), away from the sides.
    weight = em.Weight(rho=em.Expression("exp(12*x - 5*y)"))
    for radius, domain in ((0.05, UNIT), (0.1, UNIT), (0.05, em.Rectangle(x=(0.0, 1.0), y=(-2.0, 1.0)))):
        x, y = np.meshgrid(np.linspace(0.45, 0.5, 50), np.linspace(0.5, 0.55, 50))
        got = em.Smoothed(monitor=weight, radius=radius).on(domain).metric(x, y)[0]
        expected = np.exp(12 * x - 5 * y + 0.5 * (12**2 + 5**2) * radius**2)
        assert got == pytest.approx(expected, rel=2e-3)
    # near a side the part of the Gaussian that lies inside counts: at x = 0 the half of it
    line = em.Smoothed(monitor=em.Weight(rho=em.Expression("1 + x")), radius=0.05).on(UNIT)
    value = line.metric(np.array([0.0]), np.array([0.5]))[0]
    assert value == pytest.approx([1 + 0.05 * math.sqrt(2 / math.pi)], abs=1e-3)


def test_a_smoothed_front_is_milder_and_its_metric_positive_definite_and_smooth() -> None:
    sharp = em.ArcLength(u=em.Expression("tanh(200*(x - y))"), a=1.0, b=0.0, scaled=False)
    x, y = points(n=301)
    low = []
    for radius in (0.002, 0.02, 0.1):
        smoothed = em.Smoothed(monitor=sharp, radius=radius).on(UNIT)
        metric = matrices(smoothed.metric(x, y))
        low.append(np.linalg.eigvalsh(metric).max())
        assert np.linalg.eigvalsh(metric).min() > 1 - 1e-9
    assert low == sorted(low, reverse=True)
    assert low[-1] < 0.1 * np.linalg.eigvalsh(matrices(sharp.metric(x, y))).max()
    line = np.linspace(0.3, 0.7, 20001)  # finer than the table: no kinks, no steps
    m11 = em.Smoothed(monitor=sharp, radius=0.1).on(UNIT).metric(line, 0 * line + 0.5)[0]
    step = line[1] - line[0]
    assert np.abs(np.diff(m11, 2)).max() < 3 * np.ptp(m11) * (step / 0.1) ** 2


def test_the_smoothed_metric_goes_on_beyond_the_sides() -> None:
    smoothed = em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False), radius=0.02).on(SECTOR)
    line = np.linspace(0, 1, 50)
    for s, t in ((0 * line, line), (0 * line + 1, line), (line, 0 * line), (line, 0 * line + 1)):
        inside = smoothed.metric(*SECTOR.map(s, t))[0]
        outside = smoothed.metric(*SECTOR.map(s + 1e-5 * (2 * s - 1), t + 1e-5 * (2 * t - 1)))[0]
        assert outside == pytest.approx(inside, rel=1e-3)


@pytest.mark.parametrize("radius", [0.0, -0.1, 0.3, math.nan])
def test_a_radius_out_of_range_is_refused(radius: float) -> None:
    with pytest.raises(em.InputError, match="radius") as caught:
        em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False), radius=radius)
    assert caught.value.field == "radius"


def test_an_unbound_smoothed_monitor_says_what_to_do() -> None:
    with pytest.raises(em.InputError, match=r"monitor\.on\(domain\)"):
        em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False)).metric(*points(n=3))


@settings(max_examples=8, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.5, 80), st.floats(0.01, 0.25))
def test_smoothed_curvature_is_positive_definite(p: float, q: float, k: float, radius: float) -> None:
    u = em.Expression("p*tanh(k*(x - y**2)) + q*cos(9*x*y) + 0.01*x", parameters={"p": p, "q": q, "k": k})
    monitor = em.Smoothed(monitor=em.Curvature(u=u), radius=radius).on(UNIT)
    assert np.linalg.eigvalsh(matrices(monitor.metric(*points(n=41)))).min() > 0


def test_the_map_of_a_smoothed_weight_is_that_of_the_weight() -> None:
    rho = em.Expression("1 + x")
    assert em.Smoothed(monitor=em.Weight(rho=rho, map="gradient")).on(UNIT).map == "gradient"
    assert em.Smoothed(monitor=em.Weight(rho=rho)).map == "lines"
    assert em.Smoothed(monitor=em.ArcLength(u=rho)).map == "lines"


# Weakened monitors: between a multiple of the identity and the monitor itself.


@every
def test_the_strengths_between_nothing_and_the_monitor_itself(name: str) -> None:
    monitor = monitors()[name].on(UNIT)
    x, y = points(n=31)
    own = matrices(monitor.metric(x, y))
    assert matrices(monitor.weakened(1.0).metric(x, y)) == pytest.approx(own, rel=1e-12)
    flat = matrices(monitor.weakened(0.0).metric(x, y))
    assert flat == pytest.approx(flat[0, 0, 0, 0] * np.broadcast_to(np.eye(2), flat.shape), abs=1e-12)
    spread = [np.linalg.cond(matrices(monitor.weakened(s).metric(x, y))).max() for s in (0.0, 0.3, 0.6, 1.0)]
    assert spread == sorted(spread)
    again = monitor.weakened(0.5).weakened(0.5).metric(x, y)
    assert matrices(again) == pytest.approx(matrices(monitor.weakened(0.25).metric(x, y)), rel=1e-9)
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(em.InputError, match="strength"):
            monitor.weakened(wrong)


@every
def test_weakening_and_binding_commute(name: str) -> None:
    monitor, (x, y) = monitors()[name], points(n=9)
    first, second = monitor.weakened(0.4).on(UNIT), monitor.on(UNIT).weakened(0.4)
    assert first.metric(x, y)[0] == pytest.approx(second.metric(x, y)[0], rel=1e-12)


# Intersections dominate each of their monitors.


def test_an_intersection_dominates_its_monitors_and_takes_the_first_u() -> None:
    weight = em.Weight(rho=em.Expression("1 + 20*x"))
    parts: tuple[Monitor, ...] = (weight, em.Curvature(u=WAVE), em.ArcLength(u=STEEP, a=1.0))
    both = em.Intersection(monitors=parts).on(UNIT)
    x, y = points()
    metric = matrices(both.metric(x, y))
    for part in both.monitors:
        assert np.linalg.eigvalsh(metric - matrices(part.metric(x, y))).min() > -1e-9
    assert both.u is WAVE
    assert em.Intersection(monitors=(weight, weight)).u is None
    for number in (1, 9):
        with pytest.raises(em.InputError, match="2 to 8"):
            em.Intersection(monitors=(weight,) * number)


def test_a_gradient_map_in_an_intersection_is_refused() -> None:
    rho = em.Expression("1 + x")
    with pytest.raises(em.InputError, match="leave out map") as caught:
        em.Intersection(monitors=(em.Weight(rho=rho), em.Weight(rho=rho, map="gradient")))
    assert caught.value.field == "monitors.1.map"


numbers = st.floats(-3.0, 3.0)


properties = settings(deadline=None)  # the first example compiles


@properties
@given(st.floats(0.0, math.pi), numbers, numbers, st.floats(-2.0, 2.0))
def test_a_power_has_the_powers_of_the_eigenvalues(angle: float, p: float, q: float, exponent: float) -> None:
    got = matrices(power(triple(angle, 10**p, 10**q), exponent))
    expected = matrices(triple(angle, 10 ** (p * exponent), 10 ** (q * exponent)))
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


@properties
@given(*[st.floats(0.0, math.pi), numbers, numbers] * 2)
def test_an_intersection_dominates_both_and_does_not_mind_the_order(
    angle: float, p: float, q: float, other_angle: float, r: float, s: float
) -> None:
    first, second = triple(angle, 10**p, 10**q), triple(other_angle, 10**r, 10**s)
    both = matrices(intersection(first, second))
    size = np.abs(both).max()
    for one in (first, second):
        assert np.linalg.eigvalsh(both - matrices(one)).min() > -1e-12 * size
    assert matrices(intersection(second, first)) == pytest.approx(both, abs=1e-9 * size)
    # and not more than that: in the basis in which both are diagonal it is the larger of each pair
    lower = np.linalg.cholesky(matrices(first)[0])
    inverse = np.linalg.inv(lower)
    size, basis = np.linalg.eigh(inverse @ matrices(second)[0] @ inverse.T)
    exact = lower @ basis @ np.diag(np.maximum(size, 1.0)) @ basis.T @ lower.T
    assert both[0] == pytest.approx(exact, abs=0.006 * np.abs(exact).max())


def test_an_intersection_with_a_much_smaller_metric_changes_nothing() -> None:
    large, small = triple(0.3, 7.0, 2.0), triple(1.1, 1e-3, 1e-4)
    assert matrices(intersection(large, small)) == pytest.approx(matrices(large), rel=1e-4)
