"""Metrics and tensors as monitors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors.metrics import extremes
from solver.monitors.metrics import SECTOR, STEEP, UNIT, matrices, points, triple

BOX = em.Rectangle(x=(1.0, 5.0), y=(0.0, 9.0))
X, Y = points(n=7)


def test_the_arc_length_weakens_by_its_own_parameter() -> None:
    assert em.ArcLength(u=STEEP, a=0.8).weakened(0.5) == em.ArcLength(u=STEEP, a=0.4)


def test_a_weaker_arc_length_keeps_its_scale() -> None:
    bound = em.ArcLength(u=em.Expression("10*x"), a=0.8).on(BOX)
    weaker = bound.weakened(0.5)
    assert weaker.factor == bound.factor == pytest.approx(6.0 / 40.0)
    assert weaker.on(BOX) is weaker
    assert bound.on(SECTOR).factor != bound.factor


def test_without_scaling_the_metric_is_the_formula_of_the_paper() -> None:
    monitor = em.ArcLength(u=em.Expression("3*x + 4*y"), a=0.5, b=0.1, scaled=False)
    k = 0.25 / (1 + 0.1 * 25)
    for bound in (monitor, monitor.on(BOX)):
        for entry, expected in zip(bound.metric(X, Y), (1 + 9 * k, 12 * k, 1 + 16 * k), strict=True):
            assert entry == pytest.approx(np.full_like(X, expected))


def test_the_gradient_is_that_of_u_over_its_range_by_lengths_over_the_size_of_the_domain() -> None:
    monitor = em.ArcLength(u=em.Expression("3*x + 4*y"), a=0.5, b=0.1).on(BOX)
    g = np.array([3.0, 4.0]) * math.sqrt(4 * 9) / (3 * 4 + 4 * 9)
    k = 0.25 / (1 + 0.1 * (g @ g))
    for entry, expected in zip(
        monitor.metric(X, Y), (1 + k * g[0] ** 2, k * g[0] * g[1], 1 + k * g[1] ** 2), strict=True
    ):
        assert entry == pytest.approx(np.full_like(X, expected))


@pytest.mark.parametrize("u", ["7", "sin(x)**2 + cos(x)**2", "1e17 + x"])
def test_a_constant_has_no_arc_length(u: str) -> None:
    bound = em.ArcLength(u=em.Expression(u)).on(UNIT)
    assert bound.factor == 0.0
    assert bound.metric(X, Y)[0] == pytest.approx(np.ones_like(X), abs=0)


def test_values_that_are_not_finite_have_no_part_in_the_range() -> None:
    assert em.ArcLength(u=em.Expression("5*y + 0/x")).on(UNIT).factor == pytest.approx(0.2)
    assert em.ArcLength(u=em.Expression("0/(x - x)")).on(UNIT).factor == 1.0


def test_an_unbound_arc_length_and_a_word_for_scaled_are_refused() -> None:
    with pytest.raises(em.InputError, match=r"call monitor\.on\(domain\) first"):
        em.ArcLength(u=STEEP).metric(X, Y)
    with pytest.raises(em.InputError, match="give True or False"):
        em.ArcLength(u=STEEP, scaled="no")  # type: ignore[arg-type]


# Curvature monitors: Huang's tensors, their area, and what does not count as curvature.


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


# Extremes of a function that do not depend on where closed lines begin.


@pytest.mark.parametrize("shift", [0.0, 0.1234, 1 / 3])
def test_extremes_between_nodes_are_found(shift: float) -> None:
    u = em.Expression(f"sin(2*pi*(x+{shift}))*(1.5+cos(2*pi*(y-{shift})))")
    low, high = extremes(u, em.Rectangle(periodic="both"))
    assert high == pytest.approx(2.5, rel=1e-13)
    assert low == pytest.approx(-2.5, rel=1e-13)


def test_sides_are_not_crossed() -> None:
    assert extremes(em.Expression("x*sin(2*pi*y)"), em.Rectangle(periodic="y")) == pytest.approx((-1.0, 1.0), rel=1e-13)


def test_a_function_without_finite_values_has_no_range() -> None:
    class Nowhere:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            return (np.full(np.shape(x + y), np.nan),) * (1 + order)

    assert extremes(Nowhere(), em.Rectangle(periodic="y")) == (0.0, 0.0)


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


def test_an_unknown_map_of_a_weight_is_refused() -> None:
    with pytest.raises(em.InputError, match="choose 'lines' or 'gradient'") as caught:
        em.Weight(rho=em.Expression("1"), map="rows")  # type: ignore[arg-type]
    assert caught.value.field == "map"


def test_a_weight_at_nodes_does_not_overshoot() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    values = np.where(nodes.x < 0.4, 1e-3, 1.0)
    spline = em.NodalField(mesh=nodes, values=values)
    x, y = np.meshgrid(*[np.linspace(0.0, 1.0, 81)] * 2, indexing="ij")
    assert spline.evaluate(x, y)[0].min() < 0.0  # what a weight cannot be
    rho = em.Weight(rho=spline).on(em.Rectangle()).metric(x, y)[0]
    assert rho.min() == pytest.approx(1e-3, rel=1e-6)
    assert rho.max() == pytest.approx(1.0, rel=1e-6)
