"""Domains: maps and their exact derivatives, areas and boxes, and a precise refusal of what cannot be meshed."""

from __future__ import annotations

import io
import math
import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.upload.samples import read_arrays, read_samples

RNG = np.random.default_rng(11)
S, T = RNG.random((2, 40, 30))
SIDES = ("bottom", "right", "top", "left")


def wavy(**changed: em.Curve) -> em.Quadrilateral:
    """A square with three curved sides, one of which runs unevenly, and one spline."""
    k = np.linspace(0, 1, 21)
    sides = {
        "bottom": em.Curve.of_expressions("t", "0.2*sin(pi*t)"),
        "right": em.Curve.of_expressions("1 + h*sin(pi*t)", "t + 0.1*t*(1 - t)", {"h": 0.1}),
        "top": em.Curve.of_expressions("t", "1 + 0.1*sin(2*pi*t)"),
        "left": em.Curve.through(np.column_stack([-0.1 * np.sin(np.pi * k), k])),
    }
    return em.Quadrilateral(**(sides | changed))


DOMAINS: dict[str, em.Domain] = {
    "square": em.Rectangle(),
    "rectangle": em.Rectangle(x=(-3, 1), y=(2, 2.5)),
    "quarter": em.AnnulusSector(),
    "sector": em.AnnulusSector(center=(3, -1), radii=(0.2, 0.5), angles=(-70, 200)),
    "ring": em.AnnulusSector(angles=(-180, 180)),
    "quadrilateral": wavy(),
}
each_domain = pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS.keys())


def refusal(make: Any, *arguments: Any, **options: Any) -> em.InputError:
    with pytest.raises(em.InputError) as caught:
        make(*arguments, **options)
    return caught.value


def line(x0: float, y0: float, x1: float, y1: float) -> em.Curve:
    return em.Curve.through([[x0, y0], [x1, y1]])


def polygon_area(domain: em.Domain, n: int) -> float:
    """By the shoelace formula, from ``n`` points a side."""
    t = np.linspace(0, 1, n)
    zero, one = np.zeros(n), np.ones(n)
    rim = [domain.map(*p) for p in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))]
    x, y = np.concatenate([p[0][:-1] for p in rim]), np.concatenate([p[1][:-1] for p in rim])
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@each_domain
class TestEveryDomain:
    def test_the_jacobian_is_that_of_the_difference_quotients(self, domain: em.Domain) -> None:
        h = 1e-6
        east, west, north, south = (
            domain.map(S + h, T),
            domain.map(S - h, T),
            domain.map(S, T + h),
            domain.map(S, T - h),
        )
        for k, (along_s, along_t) in enumerate((domain.jacobian(S, T)[:2], domain.jacobian(S, T)[2:])):
            np.testing.assert_allclose(along_s, (east[k] - west[k]) / (2 * h), atol=5e-9)
            np.testing.assert_allclose(along_t, (north[k] - south[k]) / (2 * h), atol=5e-9)

    def test_the_map_keeps_its_orientation(self, domain: em.Domain) -> None:
        s, t = np.meshgrid(np.linspace(-1e-5, 1 + 1e-5, 50), np.linspace(-1e-5, 1 + 1e-5, 50))
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        assert np.all(x_s * y_t - x_t * y_s > 0)

    def test_the_area_is_that_inside_the_sides_and_the_integral_of_the_jacobian(self, domain: em.Domain) -> None:
        coarse, fine = polygon_area(domain, 401), polygon_area(domain, 801)
        assert domain.area == pytest.approx(fine + (fine - coarse) / 3, rel=1e-8)
        nodes, weights = np.polynomial.legendre.leggauss(60)
        s, t = np.meshgrid(0.5 + 0.5 * nodes, 0.5 + 0.5 * nodes, indexing="ij")
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        assert weights @ (x_s * y_t - x_t * y_s) @ weights / 4 == pytest.approx(domain.area, rel=1e-5)

    def test_the_box_holds_the_domain_and_touches_it(self, domain: em.Domain) -> None:
        s, t = np.meshgrid(np.linspace(0, 1, 721), np.linspace(0, 1, 721), indexing="ij")
        for (low, high), found in zip(domain.box, domain.map(s, t), strict=True):
            assert low - 1e-12 <= found.min() < low + 1e-5
            assert high - 1e-5 < found.max() <= high + 1e-12

    def test_shapes(self, domain: em.Domain) -> None:
        for shape in ((), (5,), (2, 3), (0,)):
            found = (*domain.map(np.full(shape, 0.3), np.full(shape, 0.6)), *domain.jacobian(np.full(shape, 0.3), 0.6))
            assert all(np.shape(part) == shape for part in found)
        crossed = (*domain.map(S[:, :1], T[:1]), *domain.jacobian(S[:, :1], T[:1]))
        assert all(part.shape == S.shape for part in crossed)

    def test_pickling_and_equality(self, domain: em.Domain) -> None:
        again = pickle.loads(pickle.dumps(domain))
        assert again == domain
        assert hash(again) == hash(domain)
        np.testing.assert_array_equal(again.map(S, T), domain.map(S, T))
        assert (again.box, again.area) == (domain.box, domain.area)

    def test_a_mapped_mesh_has_the_area_as_its_mean_jacobian(self, domain: em.Domain) -> None:
        mesh = map_mesh(em.Mesh.uniform(em.Grid(n_xi=91, n_eta=121)), domain)
        assert mesh.corner_jacobians().mean() == pytest.approx(domain.area, rel=1e-3)
        assert not mesh.is_folded


class TestRectangle:
    def test_the_unit_square_maps_to_itself_exactly(self) -> None:
        x, y = em.Rectangle().map(S, T)
        np.testing.assert_array_equal(x, S)
        np.testing.assert_array_equal(y, T)
        mesh = em.Mesh(S, T)
        assert map_mesh(mesh, em.Rectangle()) is mesh

    def test_is_unit_square(self) -> None:
        assert em.Rectangle().is_unit_square
        assert em.Rectangle(x=[0, 1], y=np.array([0, 1])).is_unit_square  # type: ignore[arg-type]
        assert not em.Rectangle(x=(0, 2)).is_unit_square

    def test_the_sides_are_met_exactly(self) -> None:
        domain = em.Rectangle(x=(0.1, 0.7), y=(-1 / 3, 0.3))
        x, y = domain.map(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
        assert (tuple(x), tuple(y)) == domain.box

    @pytest.mark.parametrize(
        ("options", "field", "words"),
        [
            ({"x": (1, 0)}, "domain.x", "x = (1, 0): the second end must be greater"),
            ({"y": (2, 2)}, "domain.y", "y = (2, 2)"),
            ({"y": (0, math.nan)}, "domain.y", "y[1] = nan"),
            ({"x": (0, 1e10)}, "domain.x", "at most 1e+09"),
            ({"x": (0, "1")}, "domain.x", "x[1] = 1: a number"),
            ({"x": (False, 1)}, "domain.x", "x[0] = False"),
            ({"x": (0, 1, 2)}, "domain.x", "two numbers"),
            ({"x": 3}, "domain.x", "two numbers"),
            ({"x": (1e8, 1e8 + 1e-2)}, "domain.x", "too near together"),
        ],
    )
    def test_refusals(self, options: dict[str, Any], field: str, words: str) -> None:
        error = refusal(em.Rectangle, **options)
        assert error.field == field
        assert words in error.message


class TestAnnulusSector:
    def test_corners_and_sides(self) -> None:
        domain = em.AnnulusSector(center=(1, 2), radii=(1, 3), angles=(0, 90))
        corners = [tuple(map(float, domain.map(*st))) for st in ((0, 0), (1, 0), (1, 1), (0, 1))]
        assert corners == [(2, 2), (4, 2), (1, 5), (1, 3)]
        zero, one, k = np.zeros(9), np.ones(9), np.linspace(0, 1, 9)
        for s, radius in ((zero, 1), (one, 3)):
            x, y = domain.map(s, k)
            np.testing.assert_allclose(np.hypot(x - 1, y - 2), radius, rtol=1e-15)
        np.testing.assert_array_equal(domain.map(k, one)[0], one)
        np.testing.assert_array_equal(domain.map(k, zero)[1], 2 * one)

    def test_area(self) -> None:
        assert em.AnnulusSector().area == pytest.approx(math.pi * 3 / 4, rel=1e-15)
        assert DOMAINS["sector"].area == pytest.approx(0.5 * (0.25 - 0.04) * 1.5 * math.pi, rel=1e-15)

    def test_box(self) -> None:
        assert em.AnnulusSector(angles=(-90, 90)).box == ((0, 2), (-2, 2))
        assert em.AnnulusSector(angles=(-180, 180)).box == ((-2, 2), (-2, 2))
        (x0, x1), (y0, y1) = em.AnnulusSector(angles=(30, 60)).box
        np.testing.assert_allclose([x0, x1, y0, y1], [0.5, math.sqrt(3), 0.5, math.sqrt(3)])

    @pytest.mark.parametrize(
        ("options", "field", "words"),
        [
            ({"radii": (0, 1)}, "domain.radii", "must be positive"),
            ({"radii": (2, 1)}, "domain.radii", "less than the outer"),
            ({"radii": (1, 1 + 1e-12)}, "domain.radii", "too near together"),
            ({"angles": (90, 0)}, "domain.angles", "must increase"),
            ({"angles": (0, 361)}, "domain.angles", "at most 360"),
            ({"angles": (0, 1e-5)}, "domain.angles", "in degrees"),
            ({"center": (0, math.inf)}, "domain.center", "center[1] = inf"),
        ],
    )
    def test_refusals(self, options: dict[str, Any], field: str, words: str) -> None:
        error = refusal(em.AnnulusSector, **options)
        assert error.field == field
        assert words in error.message


class TestQuadrilateral:
    def test_the_sides_go_where_the_curves_go(self) -> None:
        domain, k = wavy(), np.linspace(0, 1, 33)
        for name, (s, t) in {
            "bottom": (k, 0 * k),
            "top": (k, 0 * k + 1),
            "left": (0 * k, k),
            "right": (0 * k + 1, k),
        }.items():
            np.testing.assert_allclose(domain.map(s, t), getattr(domain, name).evaluate(k)[:2], atol=1e-15)

    def test_straight_sides_give_the_bilinear_map(self) -> None:
        p = np.array([[0, 0], [2, -0.5], [2.5, 2], [0.3, 1]])
        domain = em.Quadrilateral(
            bottom=line(*p[0], *p[1]), right=line(*p[1], *p[2]), top=line(*p[3], *p[2]), left=line(*p[0], *p[3])
        )
        x, y = domain.map(S, T)
        shapes = [(1 - S) * (1 - T), S * (1 - T), S * T, (1 - S) * T]
        np.testing.assert_allclose(x, sum(w * q[0] for w, q in zip(shapes, p, strict=True)), atol=1e-14)
        np.testing.assert_allclose(y, sum(w * q[1] for w, q in zip(shapes, p, strict=True)), atol=1e-14)

    def test_a_sector_given_by_formulas_is_the_sector(self) -> None:
        arc = ("{0}*cos(pi*t/2)", "{0}*sin(pi*t/2)")
        domain = em.Quadrilateral(
            bottom=line(1, 0, 2, 0),
            top=line(0, 1, 0, 2),
            left=em.Curve.of_expressions(*(text.format(1) for text in arc)),
            right=em.Curve.of_expressions(*(text.format(2) for text in arc)),
        )
        sector = em.AnnulusSector()
        np.testing.assert_allclose(domain.map(S, T), sector.map(S, T), atol=1e-14)
        np.testing.assert_allclose(domain.jacobian(S, T), sector.jacobian(S, T), atol=1e-14)
        assert domain.area == pytest.approx(sector.area, rel=1e-12)
        np.testing.assert_allclose(domain.box, sector.box, atol=1e-14)

    def test_area(self) -> None:
        bumps = em.Curve.of_expressions("1", "t")
        exact = 1 - 0.4 / np.pi + 0.2 / np.pi  # a side x = -0.1 sin(pi y) adds 0.2 / pi
        assert wavy(right=bumps).area == pytest.approx(exact, rel=1e-6)  # the left side is a spline

    def test_corners_that_do_not_meet_are_named(self) -> None:
        error = refusal(wavy, bottom=em.Curve.of_expressions("t", "0.3*t"))
        assert error.field == "domain.right"
        assert "bottom ends at (1, 0.3), but right starts at (1, 0)" in error.message
        error = refusal(wavy, top=em.Curve.of_expressions("1 - t", "1"))
        assert "top ends at (0, 1), but right ends at (1, 1)" in error.message
        error = refusal(wavy, top=em.Curve.of_expressions("t - 0.01*(1 - t)", "1"))
        assert error.field == "domain.left"
        assert "top starts at (-0.01, 1), but left ends at (" in error.message

    def test_a_folding_patch_is_refused_with_the_place(self) -> None:
        error = refusal(wavy, bottom=em.Curve.of_expressions("t", "0.9*sin(pi*t)"), right=line(1, 0, 1, 1))
        assert error.field == "domain"
        assert "the map folds at (x, y) = (0.6" in error.message
        assert "on bottom at t = 0.6" in error.message
        x, y = (float(part) for part in error.message.split("= (")[1].split(")")[0].split(","))
        assert y == pytest.approx(0.9 * math.sin(math.pi * x), abs=1e-5)

    def test_a_map_that_is_flat_is_refused(self) -> None:
        error = refusal(wavy, left=em.Curve.of_expressions("0", "t**2"))
        assert "the map is flat at (x, y) = (0, 0), the corner of bottom and left" in error.message
        quarter = {
            name: em.Curve.of_expressions(f"cos(pi*({a} + {b}*t))", f"sin(pi*({a} + {b}*t))")
            for name, a, b in (("bottom", 1.25, 0.5), ("right", -0.25, 0.5), ("top", 0.75, -0.5), ("left", 1.25, -0.5))
        }
        assert "180 degrees" in refusal(em.Quadrilateral, **quarter).message  # a disk has no corners

    def test_a_mirrored_patch_is_refused(self) -> None:
        error = refusal(
            em.Quadrilateral,
            bottom=line(0, 0, 0, 1),
            left=line(0, 0, 1, 0),
            top=line(1, 0, 1, 1),
            right=line(0, 1, 1, 1),
        )
        assert "clockwise" in error.message
        assert "exchange bottom with left" in error.message

    def test_a_patch_that_covers_itself_is_refused_though_its_jacobian_is_positive(self) -> None:
        angle = "2.2*pi*t"
        error = refusal(
            em.Quadrilateral,
            left=em.Curve.of_expressions(f"cos({angle})", f"sin({angle})"),
            right=em.Curve.of_expressions(f"2*cos({angle})", f"2*sin({angle})"),
            bottom=line(1, 0, 2, 0),
            top=line(math.cos(2.2 * math.pi), math.sin(2.2 * math.pi), *(2 * f(2.2 * math.pi) for f in TURN)),
        )
        assert "cross" in error.message

    def test_a_ring_cut_open_is_accepted(self) -> None:
        domain = em.Quadrilateral(
            left=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"),
            right=em.Curve.of_expressions("2*cos(2*pi*t)", "2*sin(2*pi*t)"),
            bottom=line(1, 0, 2, 0),
            top=line(1, 0, 2, 0),
        )
        assert domain.area == pytest.approx(3 * math.pi, rel=1e-12)

    def test_sides_must_be_curves(self) -> None:
        assert refusal(wavy, left=[[0, 0], [0, 1]]).field == "domain.left"


TURN = (math.cos, math.sin)


class TestCurve:
    def test_formulas_in_t_with_parameters(self) -> None:
        curve = em.Curve.of_expressions("k*t**2", "exp(t) + where(t < 0.5, 0, 1)", {"k": 3})
        t = np.linspace(0, 1, 7)
        x, y, x_t, y_t = curve.evaluate(t)
        np.testing.assert_allclose([x, x_t], [3 * t**2, 6 * t], rtol=1e-14)
        np.testing.assert_allclose([y, y_t], [np.exp(t) + (t >= 0.5), np.exp(t)], rtol=1e-14)

    def test_sampled_curves_converge_at_fourth_order(self) -> None:
        def error(n: int) -> float:
            k = np.linspace(0, 1, n) ** 1.2  # uneven
            curve = em.Curve.through(np.column_stack([np.cos(2 * k), np.sin(2 * k)]))
            x, y, *_ = curve.evaluate(np.linspace(0, 1, 5001))
            return float(np.abs(np.hypot(x, y) - 1).max())

        errors = np.array([error(n) for n in (17, 33, 65)])
        assert np.all(np.log2(errors[:-1] / errors[1:]) > 3.7)
        assert errors[-1] < 1e-6

    def test_two_points_give_a_straight_line_at_constant_speed(self) -> None:
        x, y, x_t, y_t = line(1, 2, 3, -1).evaluate(T)
        np.testing.assert_allclose([x, y], [1 + 2 * T, 2 - 3 * T], atol=1e-14)
        np.testing.assert_allclose([x_t, y_t], [np.full_like(T, 2), np.full_like(T, -3)], atol=1e-14)

    def test_the_spline_passes_through_its_points(self) -> None:
        points = RNG.random((3, 2))
        curve = em.Curve.through(points)
        chords = np.hypot(*np.diff(points, axis=0).T)
        found = curve.evaluate(np.array([0, chords[0] / chords.sum(), 1]))
        np.testing.assert_allclose(np.column_stack(found[:2]), points, atol=1e-14)

    def test_the_box_is_exact(self) -> None:
        curve = em.Curve.of_expressions("sin(5*t)", "t*(1 - 1.3*t)")
        np.testing.assert_allclose(curve.box, [[-1, 1], [-0.3, 1 / 5.2]], rtol=1e-14)
        assert line(1, 2, 3, -1).box == ((1, 3), (-1, 2))

    def test_it_goes_on_along_the_tangent_where_a_formula_ends(self) -> None:
        curve = em.Curve.of_expressions("t**1.5", "sin(t)")
        x, y, x_t, y_t = curve.evaluate(np.array([-1e-5, 1 + 1e-5]))
        np.testing.assert_allclose([x, x_t], [[0, (1 + 1e-5) ** 1.5], [0, 1.5 * (1 + 1e-5) ** 0.5]], atol=1e-15)
        np.testing.assert_allclose([y, y_t], [[-1e-5, math.sin(1 + 1e-5)], [1, math.cos(1 + 1e-5)]], rtol=1e-9)

    @pytest.mark.parametrize(
        ("x", "y", "field", "offset", "words"),
        [
            ("x", "t", "x", 0, "'x' has no meaning here: a curve is given by formulas in t: write t"),
            ("t", "2*y", "y", 2, "write t"),
            ("t", "t^2", "y", 1, "use ** for powers"),
            ("t", "s", "y", 0, "known are t, pi, e"),
            ("", "t", "x", 0, "cos(pi*t/2)"),
            ("where(t, 1, 2)", "t", "x", 6, "t < 0.5"),
            ("t", "1 + log(t)", "y", 4, "y(t) is not finite at t = 0, because of log(t)"),
            ("sqrt(t)", "t", "x", 0, "the slope of x(t) is not finite at t = 0, because of sqrt(t)"),
            ("t", "1/(t - 1/3)", "y", 0, "the slope of y(t) grows without bound at t = 0.333333"),
            ("2e9*t", "t", "x", 0, "x(t) is larger than 1e+09"),
        ],
    )
    def test_formulas_are_refused_at_their_position(self, x: str, y: str, field: str, offset: int, words: str) -> None:
        for side in ("", "left"):
            error = refusal(em.Curve.of_expressions, x, y, side=side)
            assert isinstance(error, em.ExpressionError)
            assert error.field == (f"domain.left.{field}" if side else field)
            assert error.position is not None
            assert error.position.offset == offset
            assert words in error.message
            assert "unit square" not in error.message

    def test_parameters_are_checked(self) -> None:
        for name in ("x", "y", "t", "sin"):
            error = refusal(em.Curve.of_expressions, "t", "t", {name: 1.0}, side="top")
            assert error.field == f"domain.top.parameters.{name}"

    @pytest.mark.parametrize(
        ("points", "words"),
        [
            ([[0, 0]], "1 point"),
            ([[0, 0], [1, 1], [1, 1]], "points[2] repeats points[1] = (1, 1)"),
            ([[0, 0], [1, math.nan]], "points[1][1] is NaN"),
            ([[0, 0], [1, 2e9]], "points[1][1] = 2e+09"),
            ([[0, 0, 0], [1, 1, 1]], "(n, 2)"),
            ([0, 1], "a single number"),
            (np.zeros((10_001, 2)), "10001 points"),
            ([[0, 0], [0, 0]], "repeats"),
        ],
    )
    def test_points_are_refused(self, points: Any, words: str) -> None:
        error = refusal(em.Curve.through, points, side="left")
        assert error.field == "domain.left.points"
        assert words in error.message


class TestSamples:
    BOX = ((10.0, 14.0), (-2.0, -1.0))

    @staticmethod
    def u(x: Any, y: Any) -> Any:
        return np.sin(x) * np.exp(y)

    def test_a_grid_on_a_box(self) -> None:
        x, y = np.linspace(10, 14, 81), np.linspace(-2, -1, 41)
        field = em.GridSamples(x=x, y=y, values=self.u(x[:, None], y), box=self.BOX)
        p, q = 10 + 4 * S, -2 + T
        np.testing.assert_allclose(field.evaluate(p, q)[0], self.u(p, q), atol=1e-6)

    def test_a_grid_that_leaves_out_a_part_is_refused(self) -> None:
        x, y = np.linspace(10, 13.9, 9), np.linspace(-2, -1, 9)
        error = refusal(em.GridSamples, x=x, y=y, values=np.ones((9, 9)), box=self.BOX)
        assert error.field == "x"
        assert "from 10 to 13.9, but the samples must cover the domain, where x goes from 10 to 14" in error.message
        error = refusal(em.GridSamples, x=x - 5, y=y, values=np.ones((9, 9)), box=self.BOX)
        assert "add samples up to 10 and 14" in error.message
        error = refusal(em.GridSamples, x=np.linspace(0, 20, 9), y=y, values=np.ones((9, 9)), box=self.BOX)
        assert "far beyond the domain that is meshed: send only the part in [10, 14]" in error.message
        edge = np.linspace(10 + 3e-9, 14 - 3e-9, 9)  # misses the ends by less than 1e-9 of the extent
        em.GridSamples(x=edge, y=y, values=np.ones((9, 9)), box=self.BOX)
        error = refusal(em.GridSamples, x=edge + 2e-9, y=y, values=np.ones((9, 9)), box=self.BOX)
        assert error.field == "x"

    @pytest.mark.parametrize("centred", [True, False])
    def test_scattered_samples_on_a_box(self, centred: bool) -> None:
        def error(m: int) -> float:
            p, q = (np.arange(4 * m) + 0.5) / m + 10, (np.arange(m) + 0.5) / m - 2
            if not centred:
                p, q = np.linspace(10, 14, 4 * m + 1), np.linspace(-2, -1, m + 1)
            points = np.column_stack([part.ravel() for part in np.meshgrid(p, q)])
            field = em.ScatteredSamples(points=points, values=self.u(*points.T), box=self.BOX)
            assert field.grid.box == self.BOX
            assert field.grid.x.size == pytest.approx(4 * field.grid.y.size, rel=0.1)  # as dense along x as along y
            x, y = 10 + 4 * S, -2 + T
            return float(np.abs(field.evaluate(x, y)[0] - self.u(x, y)).max())

        coarse, fine = error(10), error(40)
        assert fine < 0.15 * coarse
        assert fine < 2e-3

    def test_scattered_samples_that_leave_out_a_corner_are_refused(self) -> None:
        corners = np.array([[10, -2], [14, -2], [10, -1], [13, -1]])
        error = refusal(em.ScatteredSamples, points=corners, values=np.ones(4), box=self.BOX)
        assert error.field == "points"
        assert "(14, -1) lies outside their convex hull" in error.message
        assert "cover the box [10, 14] x [-2, -1] of the domain; add samples" in error.message

    def test_the_domain_is_offered_where_the_samples_cover_another_rectangle(self) -> None:
        x, y, values = np.linspace(0, 2, 9), np.linspace(0, 1, 9), np.ones((9, 9))
        short = np.linspace(0, 0.5, 9)
        scattered = {"points": [[0, 0], [0.5, 0], [0.5, 1], [0, 1]], "values": np.ones(4)}
        for samples, given, end in (
            (em.GridSamples, {"x": x, "y": y, "values": values}, 2),
            (em.GridSamples, {"x": short, "y": y, "values": values}, 0.5),
            (em.ScatteredSamples, scattered, 0.5),
        ):
            alone = refusal(samples, **given).message
            assert f"box=((0, {end}), (0, 1)) here and domain=Rectangle(x=(0, {end}), y=(0, 1)) in the pro" in alone
            assert "unit square" in alone
            domain = refusal(samples, **given, box=em.Rectangle().box).message
            assert domain.endswith(f"or give the domain that they cover, a rectangle with x=(0, {end}), y=(0, 1)")
            other = refusal(samples, **given, box=((0, 1), (5, 6))).message
            for message in (domain, other):
                assert "unit square" not in message
            assert "give the domain" not in other
            em.Problem(
                monitor=em.ArcLength(u=samples(**given, box=((0, end), (0, 1)))),
                grid=em.Grid(n_xi=8, n_eta=8),
                domain=em.Rectangle(x=(0, end), y=(0, 1)),
            )
        triangle = {"points": [[0, 0], [0.5, 0], [0, 0.5], [0.1, 0.1]], "values": np.ones(4)}
        assert "Rectangle" not in refusal(em.ScatteredSamples, **triangle).message

    def test_files_are_read_for_a_box(self) -> None:
        values = self.u(np.linspace(10, 14, 41)[:, None], np.linspace(-2, -1, 21))
        stream = io.BytesIO()
        np.save(stream, values)
        field = read_samples(stream.getvalue(), "u.npy", box=self.BOX)
        assert isinstance(field, em.GridSamples)
        assert (field.x[0], field.x[-1], field.y[0], field.y[-1]) == (10, 14, -2, -1)
        csv = b"".join(b"%d,%d,1\n" % (x, y) for x in (10, 12, 14) for y in (-2, -1))
        assert isinstance(read_samples(csv, "u.csv", box=self.BOX), em.GridSamples)
        assert "unit square" in refusal(read_samples, csv, "u.csv").message
        assert set(read_arrays(csv, "u.csv")) == {"x", "y", "values"}  # the domain is not known yet

    def test_the_unit_square_is_the_default(self) -> None:
        k = np.linspace(0, 1, 5)
        assert em.GridSamples(x=k, y=k, values=np.ones((5, 5))).box == ((0, 1), (0, 1))
        for box in (3, ((0, 1),), ((0, 1), (1, 0)), ((0, 1), (0, "1"))):
            assert refusal(em.GridSamples, x=k, y=k, values=np.ones((5, 5)), box=box).field == "box"


class TestCheckFinite:
    def test_it_looks_at_the_domain(self) -> None:
        u = em.Expression("log(x)")
        u.check_finite(domain=em.Rectangle(x=(1, 2)))
        with pytest.raises(em.ExpressionError, match=r"at \(x, y\) = \(0, 0\)"):
            u.check_finite()
        with pytest.raises(em.ExpressionError, match=r"at \(x, y\) = \(0, 1\), because of log"):
            u.check_finite(domain=em.AnnulusSector())

    @pytest.mark.parametrize("shift", [0.0, 100.0, 1e5])
    def test_it_finds_poles_between_its_points_away_from_the_origin(self, shift: float) -> None:
        domain, parameters = em.Rectangle(x=(shift, shift + 1)), {"m": shift, "d": 1e-17 * max(1.0, shift)}
        poles = ("1/(x - m - 1/3)", "sqrt(abs(x - m - 1/3))", "1/(x - m - 0.25 + d)")  # d: a rounding error
        for pole in poles:
            with pytest.raises(em.ExpressionError, match="grows without bound"):
                em.Expression(pole, parameters=parameters).check_finite(domain=domain)
        em.Expression("tanh(1000*(x - m - 1/3))", parameters=parameters).check_finite(domain=domain)

    def test_it_finds_poles_in_a_sector(self) -> None:
        with pytest.raises(em.ExpressionError, match="grows without bound") as caught:
            em.Expression("1/(hypot(x, y) - 4/3)").check_finite(domain=em.AnnulusSector())
        x, y = (float(part) for part in caught.value.message.split("= (")[1].split(")")[0].split(","))
        assert math.hypot(x, y) == pytest.approx(4 / 3, rel=1e-4)

    def test_its_remedy_speaks_of_the_domain(self) -> None:
        with pytest.raises(em.ExpressionError, match="out of the domain"):
            em.Expression("atan2(y, x - 1.5)").check_finite(domain=em.AnnulusSector(angles=(-90, 90)))
