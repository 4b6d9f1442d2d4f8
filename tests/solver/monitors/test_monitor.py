"""Monitors: positive definite everywhere, what defines each of them, refusals with the place, binding, weakening."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh as em
from equimesh.monitors.monitor import Monitor
from equimesh.numerics import spd

STEEP = em.Expression("tanh(30*(x + y/2 - 0.75))")
WAVE = em.Expression("tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))")
UNIT = em.Rectangle()
SECTOR = em.AnnulusSector(center=(1.0, -2.0), radii=(0.5, 1.5), angles=(20.0, 250.0))

numbers = st.floats(-3.0, 3.0)
properties = settings(deadline=None)  # the first example compiles


def points(domain: em.Domain = UNIT, n: int = 101) -> tuple[np.ndarray, np.ndarray]:
    line = np.linspace(0.0, 1.0, n)
    return domain.map(*np.meshgrid(line, line, indexing="ij"))


def matrices(entries: tuple[np.ndarray, ...]) -> np.ndarray:
    """The triple of arrays as an array of 2 x 2 matrices."""
    m11, m12, m22 = (np.asarray(entry, dtype=float) for entry in entries)
    return np.stack([np.stack([m11, m12], axis=-1), np.stack([m12, m22], axis=-1)], axis=-2)


def triple(angle: float, first: float, second: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The symmetric matrix with these eigenvalues, ``first`` in the direction ``angle``; arrays of one element."""
    c, s = math.cos(angle), math.sin(angle)
    entries = (first * c * c + second * s * s, (first - second) * s * c, first * s * s + second * c * c)
    return tuple(np.array([entry]) for entry in entries)  # type: ignore[return-value]


def monitors() -> dict[str, Monitor]:
    arc = em.ArcLength(u=STEEP, a=0.9, b=0.01)
    return {
        "arc_length": arc,
        "curvature l2": em.Curvature(u=STEEP),
        "curvature h1": em.Curvature(u=STEEP, norm="h1"),
        "isotropic": em.Curvature(u=STEEP, isotropic=True),
        "isotropic h1": em.Curvature(u=STEEP, isotropic=True, norm="h1"),
        "weight": em.Weight(rho=em.Expression("1 + 9*exp(-20*(x - y)**2)"), u=STEEP),
        "tensor": em.Tensor(m11=em.Expression("2 + x**2"), m12=em.Expression("sin(x*y)"), m22=em.Expression("3")),
        "intersection": em.Intersection(monitors=(arc, em.Curvature(u=WAVE))),
        "smoothed": em.Smoothed(monitor=arc, radius=0.04),
        "smoothed intersection": em.Smoothed(
            monitor=em.Intersection(monitors=(em.Smoothed(monitor=arc, radius=0.1), em.Curvature(u=WAVE))), radius=0.02
        ),
    }


every = pytest.mark.parametrize("name", list(monitors()))


# Symmetric 2 x 2 matrices


@properties
@given(st.floats(0.0, math.pi), numbers, numbers, st.floats(-2.0, 2.0))
def test_a_power_has_the_powers_of_the_eigenvalues(angle: float, p: float, q: float, exponent: float) -> None:
    got = matrices(spd.power(triple(angle, 10**p, 10**q), exponent))
    expected = matrices(triple(angle, 10 ** (p * exponent), 10 ** (q * exponent)))
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


@properties
@given(st.floats(0.0, math.pi), numbers, numbers, st.sampled_from([0.0, 0.3]))
def test_the_absolute_value_has_those_of_the_eigenvalues(angle: float, p: float, q: float, rounding: float) -> None:
    got = matrices(spd.absolute(triple(angle, p, q), rounding))
    expected = matrices(triple(angle, math.hypot(p, rounding), math.hypot(q, rounding)))
    assert got == pytest.approx(expected, abs=1e-7)


def test_the_absolute_value_is_smooth_where_an_eigenvalue_changes_sign() -> None:
    value = np.linspace(-0.01, 0.01, 2001)
    zero = np.zeros_like(value)
    kink = [np.abs(np.diff(spd.absolute((value, zero, zero + 1.0), r)[0], 2)).max() for r in (0.0, 0.01)]
    assert kink[0] > 1e-5  # |value| itself
    assert kink[1] < 2e-8  # (1e-5)^2 / rounding


@properties
@given(*[st.floats(0.0, math.pi), numbers, numbers] * 2)
def test_an_intersection_dominates_both_and_does_not_mind_the_order(
    angle: float, p: float, q: float, other_angle: float, r: float, s: float
) -> None:
    first, second = triple(angle, 10**p, 10**q), triple(other_angle, 10**r, 10**s)
    both = matrices(spd.intersection(first, second))
    size = np.abs(both).max()
    for one in (first, second):
        assert np.linalg.eigvalsh(both - matrices(one)).min() > -1e-12 * size
    assert matrices(spd.intersection(second, first)) == pytest.approx(both, abs=1e-9 * size)
    # and not more than that: in the basis in which both are diagonal it is the larger of each pair
    lower = np.linalg.cholesky(matrices(first)[0])
    inverse = np.linalg.inv(lower)
    size, basis = np.linalg.eigh(inverse @ matrices(second)[0] @ inverse.T)
    exact = lower @ basis @ np.diag(np.maximum(size, 1.0)) @ basis.T @ lower.T
    assert both[0] == pytest.approx(exact, abs=0.006 * np.abs(exact).max())


def test_an_intersection_with_a_much_smaller_metric_changes_nothing() -> None:
    large, small = triple(0.3, 7.0, 2.0), triple(1.1, 1e-3, 1e-4)
    assert matrices(spd.intersection(large, small)) == pytest.approx(matrices(large), rel=1e-4)


# All monitors


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
def test_binding_again_to_the_same_domain_costs_nothing(name: str) -> None:
    bound = monitors()[name].on(UNIT)
    assert bound.on(em.Rectangle()) is bound
    weak = bound.weakened(0.5)
    assert weak.on(UNIT) is weak


@every
def test_weakening_and_binding_commute(name: str) -> None:
    monitor, (x, y) = monitors()[name], points(n=9)
    first, second = monitor.weakened(0.4).on(UNIT), monitor.on(UNIT).weakened(0.4)
    assert first.metric(x, y)[0] == pytest.approx(second.metric(x, y)[0], rel=1e-12)


@every
def test_a_bound_monitor_can_be_pickled(name: str) -> None:
    monitor, (x, y) = monitors()[name].on(UNIT), points(n=9)
    copy = pickle.loads(pickle.dumps(monitor))
    assert np.array_equal(matrices(copy.metric(x, y)), matrices(monitor.metric(x, y)))


def test_the_arc_length_weakens_by_its_own_parameter() -> None:
    assert em.ArcLength(u=STEEP, a=0.8).weakened(0.5) == em.ArcLength(u=STEEP, a=0.4)


# Curvature


@pytest.mark.parametrize("domain", [UNIT, SECTOR, em.Rectangle(x=(0.0, 300.0), y=(-1.0, 50.0))])
@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_half_of_the_metric_s_area_is_that_of_the_domain(domain: em.Domain, isotropic: bool, norm: str) -> None:
    u = em.Expression("exp(-((x - 1)**2 + (y + 2)**2)) + 0.01*x*y")
    monitor = em.Curvature(u=u, isotropic=isotropic, norm=norm).on(domain)  # type: ignore[arg-type]
    middle = (np.arange(600) + 0.5) / 600
    s, t = np.meshgrid(middle, middle, indexing="ij")
    m11, m12, m22 = monitor.metric(*domain.map(s, t))
    x_s, x_t, y_s, y_t = domain.jacobian(s, t)
    total = np.mean(np.sqrt(m11 * m22 - m12**2) * (x_s * y_t - x_t * y_s))
    assert total == pytest.approx(2 * domain.area, rel=2e-3)


@pytest.mark.parametrize(("p", "q"), [(3.0, 1.0), (2.0, -0.5), (-1.0, -1.0)])
def test_the_tensors_of_huang_for_a_quadratic(p: float, q: float) -> None:
    # H = diag(p, q) everywhere, turned by 0.4; a tiny floor leaves |H| alone.
    (h11,), (h12,), (h22,) = triple(0.4, p, q)
    u = em.Expression(
        "h11*x**2/2 + h12*x*y + h22*y**2/2 + x - 2*y + 5", parameters={"h11": h11, "h12": h12, "h22": h22}
    )
    x, y = points(n=7)
    for norm in ("l2", "h1"):
        monitor = em.Curvature(u=u, norm=norm, floor=1e-9).on(UNIT)  # type: ignore[arg-type]
        assert monitor.alpha is not None
        first, second = 1 + abs(p) / monitor.alpha, 1 + abs(q) / monitor.alpha
        l2, h1 = (first * second) ** (-1 / 6), (first * second) ** (-1 / 4) * ((first + second) / 2) ** 0.5
        scale = l2 if norm == "l2" else h1
        expected = matrices(triple(0.4, scale * first, scale * second))[0]
        got = matrices(monitor.metric(x, y))
        assert got == pytest.approx(np.broadcast_to(expected, got.shape), rel=1e-6)
        assert np.linalg.det(expected) == pytest.approx(4.0, rel=1e-8)  # the area in M is twice that of the square
        round_one = em.Curvature(u=u, norm=norm, isotropic=True).on(UNIT).metric(x, y)  # type: ignore[arg-type]
        assert matrices(round_one) == pytest.approx(np.broadcast_to(2 * np.eye(2), got.shape), abs=1e-8)


@pytest.mark.parametrize("text", ["2*x - 3*y", "7", "0"])
def test_the_curvature_of_a_linear_function_is_a_multiple_of_the_identity(text: str) -> None:
    monitor = em.Curvature(u=em.Expression(text)).on(SECTOR)
    assert monitor.alpha == math.inf
    m11, m12, m22 = monitor.metric(*points(SECTOR, 5))
    assert np.ptp(m11) == np.ptp(m22) == 0.0
    assert np.array_equal(m11, m22)
    assert not m12.any()


def test_rounding_in_linear_samples_is_not_curvature() -> None:
    axis = np.linspace(0, 1, 300)
    samples = em.GridSamples(x=axis, y=axis, values=1e3 + 0.1 * axis[:, None] + 0.7 * axis)
    assert np.abs(samples.evaluate(axis, axis, order=2)[3]).max() > 0
    assert em.Curvature(u=samples).on(UNIT).alpha == math.inf


def test_the_curvature_does_not_know_the_size_of_u_or_of_the_domain() -> None:
    x, y = points()
    one = em.Curvature(u=em.Expression("sin(3*x)*exp(y)")).on(UNIT).metric(x, y)
    two = em.Curvature(u=em.Expression("1e6*sin(3*x/50)*exp(y/50)")).on(em.Rectangle(x=(0, 50), y=(0, 50)))
    assert matrices(two.metric(50 * x, 50 * y)) == pytest.approx(matrices(one), rel=1e-9)


def test_a_curvature_monitor_wants_a_domain_and_second_derivatives() -> None:
    unbound = em.Curvature(u=STEEP)
    with pytest.raises(em.InputError, match=r"monitor\.on\(domain\)"):
        unbound.metric(*points(n=3))
    with pytest.raises(em.InputError, match=r"second derivatives are not finite at \(x, y\)") as caught:
        em.Curvature(u=em.Expression("where(x > 0.5, (x - 0.75)**1.5, 0)")).on(UNIT)
    assert caught.value.field == "u"
    bound = unbound.on(UNIT)
    assert bound.on(SECTOR).alpha == unbound.on(SECTOR).alpha != bound.alpha
    assert replace(bound, norm="h1").alpha is None
    for wrong, field in (({"norm": "max"}, "norm"), ({"floor": 0.0}, "floor"), ({"floor": math.nan}, "floor")):
        with pytest.raises(em.InputError, match=field) as caught:
            em.Curvature(u=STEEP, **wrong)  # type: ignore[arg-type]
        assert caught.value.field == field


# Weight, tensor, intersection


@pytest.mark.parametrize(
    ("rho", "message"),
    [
        ("x + y - 0.5", r"rho = -0\.5 at \(x, y\) = \(0, 0\).*positive"),
        ("1 - exp(-30*((x - 0.25)**2 + (y - 0.75)**2))", r"rho = 0 at \(x, y\) = \(0\.25, 0\.75\)"),
        ("1/(x - 1)**2", r"rho is not finite at \(x, y\) = \(1, 0\)"),
    ],
)
def test_a_weight_that_is_not_positive_is_refused_with_the_place(rho: str, message: str) -> None:
    with pytest.raises(em.InputError, match=message) as caught:
        em.Weight(rho=em.Expression(rho)).on(UNIT)
    assert caught.value.field == "rho"


@pytest.mark.parametrize(
    ("entries", "message", "field"),
    [
        (("1", "2*x", "1"), r"\[\[1, 2\], \[2, 1\]\] at \(x, y\) = \(1, 0\).*smallest eigenvalue is -1;", "m12"),
        (("y - 0.5", "0", "1"), r"at \(x, y\) = \(0, 0\).*smallest eigenvalue is -0\.5;", "m11"),
        (("1", "0", "-1"), r"smallest eigenvalue is -1;", "m22"),
        (("1", "1", "1"), r"smallest eigenvalue is 0;", "m12"),
        (("1", "log(x)", "1"), r"m12 is not finite at \(x, y\) = \(0, 0\)", "m12"),
    ],
)
def test_a_tensor_that_is_not_positive_definite_is_refused_with_the_place(
    entries: tuple[str, str, str], message: str, field: str
) -> None:
    m11, m12, m22 = (em.Expression(entry) for entry in entries)
    tensor = em.Tensor(m11=m11, m12=m12, m22=m22)
    with pytest.raises(em.InputError, match=message) as caught:
        tensor.on(UNIT)
    assert caught.value.field == field
    nested = em.Intersection(monitors=(em.ArcLength(u=STEEP), em.Smoothed(monitor=tensor)))
    with pytest.raises(em.InputError, match=message) as caught:
        nested.on(UNIT)
    assert caught.value.field == f"monitors.1.{field}"


def test_a_tensor_is_checked_on_its_domain_and_not_elsewhere() -> None:
    weight = em.Weight(rho=em.Expression("x - 1"))
    assert weight.on(em.Rectangle(x=(1.5, 2.0))).metric(np.array([1.75]), np.array([0.0]))[0] == 0.75
    with pytest.raises(em.InputError, match="rho"):
        weight.on(UNIT)


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


# Smoothing


@pytest.mark.parametrize("domain", [UNIT, SECTOR, em.Rectangle(x=(0.0, 40.0))], ids=["square", "sector", "long"])
@pytest.mark.parametrize("radius", [1e-4, 0.01, 0.05, 0.25])
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
    sharp = em.ArcLength(u=em.Expression("tanh(200*(x - y))"), a=1.0, b=0.0)
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
    smoothed = em.Smoothed(monitor=em.ArcLength(u=STEEP), radius=0.02).on(SECTOR)
    line = np.linspace(0, 1, 50)
    for s, t in ((0 * line, line), (0 * line + 1, line), (line, 0 * line), (line, 0 * line + 1)):
        inside = smoothed.metric(*SECTOR.map(s, t))[0]
        outside = smoothed.metric(*SECTOR.map(s + 1e-5 * (2 * s - 1), t + 1e-5 * (2 * t - 1)))[0]
        assert outside == pytest.approx(inside, rel=1e-3)


@pytest.mark.parametrize("radius", [0.0, -0.1, 0.3, math.nan])
def test_a_radius_out_of_range_is_refused(radius: float) -> None:
    with pytest.raises(em.InputError, match="radius") as caught:
        em.Smoothed(monitor=em.ArcLength(u=STEEP), radius=radius)
    assert caught.value.field == "radius"


def test_an_unbound_smoothed_monitor_says_what_to_do() -> None:
    with pytest.raises(em.InputError, match=r"monitor\.on\(domain\)"):
        em.Smoothed(monitor=em.ArcLength(u=STEEP)).metric(*points(n=3))


@settings(max_examples=20, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.5, 80), st.floats(0.01, 0.25))
def test_smoothed_curvature_is_positive_definite(p: float, q: float, k: float, radius: float) -> None:
    u = em.Expression("p*tanh(k*(x - y**2)) + q*cos(9*x*y) + 0.01*x", parameters={"p": p, "q": q, "k": k})
    monitor = em.Smoothed(monitor=em.Curvature(u=u), radius=radius).on(UNIT)
    assert np.linalg.eigvalsh(matrices(monitor.metric(*points(n=41)))).min() > 0
