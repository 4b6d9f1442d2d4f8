"""Problems and their metrics: what is refused, and what the equations get."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.metric import ReferenceMetric, quadratic
from equimesh.equations.problem import SideLine, sides, understood
from equimesh.testing.geometries import l_shape

U = em.Expression("tanh(9*(x - y))")
GRID = em.Grid(n_xi=9, n_eta=7)
SECTOR = em.AnnulusSector()


def test_the_monitor_is_bound_to_the_domain() -> None:
    case = em.Problem(monitor=em.Curvature(u=U), grid=GRID, domain=SECTOR)
    assert case.monitor == em.Curvature(u=U).on(SECTOR)
    assert case.monitor.on(SECTOR) is case.monitor
    with pytest.raises(em.InputError, match="rho"):
        em.Problem(monitor=em.Weight(rho=em.Expression("x - 0.5")), grid=GRID)


def test_the_equations_are_those_of_the_grid_and_the_boundary() -> None:
    case = em.Problem(monitor=em.ArcLength(u=U), grid=GRID, boundary=em.Boundary.ORTHOGONAL)
    equations = case.equations(0.25)
    assert equations.shape == (9, 7)
    assert (equations.d_xi, equations.d_eta) == (1 / 8, 1 / 6)
    assert equations.cross_line == 0.25
    assert {getattr(side, "kind", None) for side in equations.conditions} == {em.Boundary.ORTHOGONAL}
    assert case.equations().cross_line == 0.0
    assert equations.metric is case.metric


def test_another_grid_keeps_the_metric() -> None:
    """What it measures of u is measured once for all levels of a nested iteration."""
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("x + y")), grid=em.Grid(n_xi=9, n_eta=5))
    other = problem.on_grid(em.Grid(n_xi=17, n_eta=9))
    assert other == em.Problem(monitor=problem.monitor, grid=em.Grid(n_xi=17, n_eta=9))
    assert other.metric is problem.metric


# Sides of the unit square as conditions: where their nodes lie, and the metric lengths of their edges.


WEIGHT = em.Weight(rho=em.Expression("1 + x*y + 3*exp(-9*(x - y)**2)"))
WIDE_SECTOR = em.AnnulusSector(angles=(5, 85))
every_boundary = pytest.mark.parametrize("boundary", em.Boundary)


@every_boundary
def test_the_four_sides_hold_their_points(boundary: em.Boundary) -> None:
    t, values = np.linspace(0, 1, 5), np.arange(20).reshape(4, 5)
    found = sides(boundary)
    assert set(found) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    for (axis, end), side in found.items():
        points = side.points(t)
        assert (points[axis] == end).all()
        assert (points[1 - axis] == t).all()
    assert found[0, 1].line(values).tolist() == [15, 16, 17, 18, 19]
    assert found[0, 1].line(values, 1).tolist() == [10, 11, 12, 13, 14]
    assert found[1, 0].line(values, 2).tolist() == [2, 7, 12, 17]


@every_boundary
def test_a_node_off_its_side_is_seen_by_the_row_of_its_fixed_coordinate(boundary: em.Boundary) -> None:
    case = problem("ring", 7, 6, boundary=boundary)
    equations, mesh = case.equations(), em.Mesh.uniform(case.grid)
    mesh.x[-1, 2] = 1.25
    found = sides(boundary)[0, 1].rows(equations.window(equations.vector(mesh)))
    fixed = found.values[: mesh.x.shape[1]]
    assert fixed.tolist() == [0, 0, 0.25, 0, 0, 0]


@pytest.mark.parametrize("domain", [em.Rectangle(), WIDE_SECTOR], ids=["square", "sector"])
@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
@pytest.mark.parametrize("monitor", [problem("ring", 9).monitor, WEIGHT], ids=["arc length", "weight"])
def test_fluxes_change_as_their_derivatives_say(
    monitor: em.ArcLength, boundary: em.Boundary, domain: em.Domain
) -> None:
    metric = em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=9), domain=domain).metric
    t, change = np.linspace(0.05, 0.95, 9) ** 1.3, np.cos(np.arange(9.0))
    for side in sides(boundary).values():
        by_first, by_second = SideLine.of(side, metric, t).flux_derivatives
        ahead, behind = (SideLine.of(side, metric, t + h * change).fluxes for h in (1e-5, -1e-5))
        slope = by_first * change[:-1] + by_second * change[1:]
        assert slope == pytest.approx((ahead - behind) / 2e-5, abs=1e-6 * abs(slope).max())


def test_without_a_monitor_edges_have_their_own_length() -> None:
    flat = problem("ring", 9, a=0.0)
    t = np.array([0.0, 0.1, 0.4, 1.0])
    for side in sides(em.Boundary.TRACE).values():
        assert SideLine.of(side, flat.metric, t).fluxes == pytest.approx(np.diff(t) ** 2)


def test_the_paper_s_condition_sees_u_along_the_side_alone() -> None:
    """u changes across the left side only: the trace condition sees it, equation (7) does not."""
    case = problem("ring", 9, a=1.0, b=0.5)
    case = replace(case, monitor=replace(case.monitor, u=em.Expression("5*x + y")))
    t = np.linspace(0, 1, 4)
    alone, trace = (
        SideLine.of(sides(kind)[0, 0], case.metric, t).fluxes
        for kind in (em.Boundary.EQUIDISTRIBUTED_1D, em.Boundary.TRACE)
    )
    assert alone == pytest.approx((1 + 1 / (1 + 0.5 * 1)) / 9)
    assert trace == pytest.approx((1 + 1 / (1 + 0.5 * 26)) / 9)


# Problems on blocks: the monitors that they take, and what is said to others.


U_ON_BLOCKS = em.Expression("tanh(9*(x + y))")


@pytest.mark.parametrize("monitor", [em.LeastError(u=U_ON_BLOCKS), em.Auto(u=U_ON_BLOCKS)])
def test_monitors_are_bound_to_the_domain(monitor: em.LeastError | em.Auto) -> None:
    problem = em.Problem(monitor=monitor, domain=l_shape(300))
    assert problem.points == problem.domain.points
    assert problem.monitor.on(problem.domain) is problem.monitor


@pytest.mark.parametrize(
    ("monitor", "field", "text"),
    [
        (em.ArcLength(u=U_ON_BLOCKS), "monitor", "re-entrant corners"),
        (em.Curvature(u=U_ON_BLOCKS), "monitor", "LeastError"),
        (em.LeastError(u=U_ON_BLOCKS, rectilinear=True), "monitor.rectilinear", "no lines that could stay straight"),
        (em.Auto(u=U_ON_BLOCKS, purpose="finite_volume"), "monitor.purpose", "orthogonality"),
        (em.LeastError(u=em.Expression("1/(x + 100) + log(x)")), "u", "not finite at"),
    ],
)
def test_other_requests_are_refused_with_what_to_do(monitor: em.Monitor, field: str, text: str) -> None:
    with pytest.raises(em.InputError, match=re.escape(text)) as caught:
        em.Problem(monitor=monitor, domain=l_shape(300))
    assert caught.value.field == field


def test_a_round_does_not_bound_angles() -> None:
    domain = l_shape(300)
    u = em.QuadField(mesh=domain.mesh, values=domain.mesh.x)
    with pytest.raises(em.InputError, match="take LeastError with the same values") as caught:
        em.Problem(monitor=em.NodalSolution(u=u, orthogonality=50.0), domain=domain)
    assert caught.value.field == "monitor.orthogonality"


def test_blocks_have_no_grid_and_domains_with_four_sides_need_one() -> None:
    domain, grid = l_shape(300), em.Grid(n_xi=5, n_eta=5)
    with pytest.raises(em.InputError, match="leave the grid out, and refine the blocks") as caught:
        em.Problem(monitor=em.Auto(u=U_ON_BLOCKS), grid=grid, domain=domain)
    assert caught.value.field == "grid"
    with pytest.raises(em.InputError, match="leave the boundary out") as caught:
        em.Problem(monitor=em.Auto(u=U_ON_BLOCKS), boundary=em.Boundary.ORTHOGONAL, domain=domain)
    assert caught.value.field == "boundary"
    with pytest.raises(em.InputError, match=r"give Grid\(n_xi=") as caught:
        em.Problem(monitor=em.Auto(u=U_ON_BLOCKS), domain=em.Rectangle())
    assert caught.value.field == "grid"


@pytest.mark.parametrize(
    ("name", "now"),
    [
        ("BlockProblem", "Problem"),
        ("BlockSolution", "Solution"),
        ("BlockSchwarz", "Schwarz"),
        ("BlockSequence", "Sequence"),
        ("BlockStep", "SequenceStep"),
        ("QuadMesh", "Mesh"),
    ],
)
def test_names_before_say_the_name_now(name: str, now: str) -> None:
    with pytest.raises(AttributeError, match=f"equimesh.{name} is equimesh.{now} now"):
        getattr(em, name)
    assert name not in em.__all__
    assert now in em.__all__


# The formulas of a problem that were typed in another spelling, wherever they are in it.


FEW_POINTS = em.Grid(n_xi=5, n_eta=5)


def test_formulas_in_the_language_are_left_out() -> None:
    monitor = em.Weight(rho=em.Expression("1 + x**2"), u=em.Expression("x*y"))
    assert understood(em.Problem(monitor=monitor, grid=FEW_POINTS)) == {}


def test_formulas_are_named_by_their_place() -> None:
    side = em.Curve.of_expressions("t", "0.2 sin(πt)")
    left, right = em.Curve.through([(0, 0), (0, 1)]), em.Curve.through([(1, 0), (1, 1)])
    top = em.Curve.through([(0, 1), (1, 1)])
    domain = em.Quadrilateral(bottom=side, top=top, left=left, right=right)
    arc = em.ArcLength(u=em.Expression("2x"))
    both = em.Intersection(monitors=(em.Curvature(u=em.Expression("x^2")), em.Curvature(u=em.Expression("y**2"))))
    assert understood(em.Problem(monitor=arc, domain=domain, grid=FEW_POINTS)) == {
        "monitor.u": "2*x",
        "domain.bottom.y": "0.2*sin(pi*t)",
    }
    assert understood(em.Problem(monitor=both, grid=FEW_POINTS)) == {"monitor.monitors[0].u": "x**2"}


def test_the_certificate_tells_them() -> None:
    typed = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression("x^2")), grid=FEW_POINTS))
    plain = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression("x**2")), grid=FEW_POINTS))
    assert typed.certificate.understood == {"monitor.u": "x**2"}
    assert typed.certificate.summary()["understood"] == {"monitor.u": "x**2"}
    assert plain.certificate.understood == {}
    assert (typed.mesh.x == plain.mesh.x).all()


RING = em.AnnulusSector(center=(1, 0), angles=(-30, 80))
S, T = np.random.default_rng(8).random((2, 30))
TENSOR = em.Tensor(m11=em.Expression("2 + x"), m12=em.Expression("y/3"), m22=em.Expression("4"))


def test_lengths_on_the_reference_square_are_those_of_the_images() -> None:
    metric = ReferenceMetric(TENSOR.on(RING), RING)
    x_s, x_t, y_s, y_t = RING.jacobian(S, T)
    d = np.cos(7 * S), np.sin(5 * T)
    image = x_s * d[0] + x_t * d[1], y_s * d[0] + y_t * d[1]
    expected = quadratic(TENSOR.metric(*RING.map(S, T)), image)
    assert quadratic(metric.base(S, T), d) == pytest.approx(expected)


def test_the_base_of_the_arc_length_is_the_map_alone_and_u_is_differentiated_through_it() -> None:
    metric = ReferenceMetric(em.ArcLength(u=em.Expression("x**2*y")), RING)
    x_s, x_t, y_s, y_t = RING.jacobian(S, T)
    assert np.array(metric.base(S, T)) == pytest.approx(np.array([x_s**2 + y_s**2, 0 * S, x_t**2 + y_t**2]), abs=1e-12)
    h = 1e-6
    u, u_s, u_t = metric.u_with_gradient(S, T)
    assert u == pytest.approx(metric.u(S, T))
    assert u_s == pytest.approx((metric.u(S + h, T) - metric.u(S - h, T)) / (2 * h), abs=1e-8)
    assert u_t == pytest.approx((metric.u(S, T + h) - metric.u(S, T - h)) / (2 * h), abs=1e-8)


def test_a_turned_metric_exchanges_points_and_entries() -> None:
    metric = ReferenceMetric(TENSOR.on(RING), RING)
    turned = ReferenceMetric(TENSOR.on(RING), RING, turned=True)
    assert np.array(turned.base(T, S)) == pytest.approx(np.array(metric.base(S, T))[::-1])


def test_slopes_of_the_base_are_known_to_vanish_where_the_map_is_linear() -> None:
    arc_length = em.ArcLength(u=em.Expression("x*y"))
    assert ReferenceMetric(arc_length, em.Rectangle(x=(0, 3))).base_slopes(S, T) is None
    found = ReferenceMetric(arc_length, em.AnnulusSector(radii=(1, 3))).base_slopes(S, T)
    # x_t^2 + y_t^2 = (angle (1 + 2 s))^2, of which the derivative by s is 4 angle^2 (1 + 2 s).
    assert found[0][2] == pytest.approx((np.pi / 2) ** 2 * 4 * (1 + 2 * S), rel=1e-6)
    assert found[1][2] == pytest.approx(0 * S, abs=1e-6)


@pytest.mark.parametrize(
    ("u", "expected"), [("x + y - 1", 1.0), ("7", 1.0), ("1000 + x", 1001.0), ("1e6 - y", 1e6)], ids=str
)
def test_cancellation_is_the_size_of_u_over_its_variation(u: str, expected: float) -> None:
    assert ReferenceMetric(em.ArcLength(u=em.Expression(u)), em.Rectangle()).cancellation == pytest.approx(expected)


def test_other_monitors_do_not_see_u_through_the_mesh() -> None:
    metric = ReferenceMetric(TENSOR.on(RING), RING)
    assert metric.arc_length is None
    assert not metric.on_unit_square
    assert not np.any(metric.u_with_gradient(S, T))
    k, slope, raised = metric.strength((S, T), metric.base(S, T))
    assert not np.any(k)
    assert not np.any(slope)
    assert not np.any(raised)
