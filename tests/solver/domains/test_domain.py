"""What every domain promises of its map, area and box; rectangles and sectors in particular."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import (
    PLACES,
    areas_between,
    close_seam,
    closed_of,
    cut_off,
    is_closed,
    map_mesh,
    most_cut_off,
    periods_of,
)
from solver.domains.shapes import DOMAINS, S, T, line, refusal

each_domain = pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS.keys())


def polygon_area(domain: em.Domain, n: int) -> float:
    """By the shoelace formula, from ``n`` points a side."""
    t = np.linspace(0, 1, n)
    zero, one = np.zeros(n), np.ones(n)
    rim = [domain.map(*p) for p in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))]
    x, y = np.concatenate([p[0][:-1] for p in rim]), np.concatenate([p[1][:-1] for p in rim])
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@each_domain
class TestEveryDomain:
    def test_the_area_is_that_inside_the_sides_and_the_integral_of_the_jacobian(self, domain: em.Domain) -> None:
        coarse, fine = polygon_area(domain, 401), polygon_area(domain, 801)
        assert domain.area == pytest.approx(fine + (fine - coarse) / 3, rel=1e-8)
        nodes, weights = np.polynomial.legendre.leggauss(60)
        s, t = np.meshgrid(0.5 + 0.5 * nodes, 0.5 + 0.5 * nodes, indexing="ij")
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        assert weights @ (x_s * y_t - x_t * y_s) @ weights / 4 == pytest.approx(domain.area, rel=1e-5)

    def test_pickling_and_equality(self, domain: em.Domain) -> None:
        again = pickle.loads(pickle.dumps(domain))
        assert again == domain
        assert hash(again) == hash(domain)
        np.testing.assert_array_equal(again.map(S, T), domain.map(S, T))
        assert (again.box, again.area) == (domain.box, domain.area)


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
            ({"x": (0, "1")}, "domain.x", "x[1] = 1: must be a number"),
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


# Closed lines: which there are, and the second copies of seams.


@pytest.mark.parametrize(("periodic", "closed"), [(None, (0, 0)), ("x", (1, 0)), ("y", (0, 1)), ("both", (1, 1))])
def test_lines_across_a_periodic_direction_are_closed(periodic: str | None, closed: tuple[int, int]) -> None:
    domain = em.Rectangle(x=(1.0, 4.0), y=(0.0, 2.0), periodic=periodic)  # type: ignore[arg-type]
    assert closed_of(domain) == closed
    assert is_closed(domain) == any(closed)
    assert periods_of(domain) == ((3.0 * closed[0], 0.0), (0.0, 2.0 * closed[1]))


def test_a_domain_that_says_nothing_has_four_sides() -> None:
    assert closed_of(object()) == (False, False)
    assert periods_of(object()) == ((0.0, 0.0), (0.0, 0.0))


def test_the_second_copy_is_the_first_one_moved_by_the_period() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.random((5, 4)), rng.random((5, 4))
    close_seam(x, y, em.Rectangle(x=(0.0, 3.0), periodic="both"))
    assert np.array_equal(x[-1], x[0] + 3.0)
    assert np.array_equal(y[-1], y[0])
    assert np.array_equal(y[:, -1], y[:, 0] + 1.0)


def test_a_closed_ring_is_one_turn_and_its_seam_is_one_line() -> None:
    ring = em.AnnulusSector(closed=True)
    assert ring.angles == (0.0, 360.0)
    mesh = map_mesh(em.Mesh.uniform(em.Grid(n_xi=5, n_eta=9)), ring)
    assert np.array_equal(mesh.x[:, -1], mesh.x[:, 0])
    assert np.array_equal(mesh.y[:, -1], mesh.y[:, 0])


def test_an_open_line_named_closed_is_refused() -> None:
    with pytest.raises(em.InputError, match=r"span 300 degrees: the lines around a ring close after 360") as error:
        em.AnnulusSector(angles=(0.0, 300.0), closed=True)
    assert error.value.field == "domain.closed"
    with pytest.raises(em.InputError, match="choose 'x', 'y' or 'both'") as error:
        em.Rectangle(periodic="z")  # type: ignore[arg-type]
    assert error.value.field == "domain.periodic"


# O-grids between four curves: their seam, the smooth curves through it, and what is refused.


TURN = np.linspace(0.0, -2.0 * np.pi, 33)
ROUND = {
    "bottom": em.Curve.through(np.column_stack([0.6 * np.cos(TURN), 0.3 * np.sin(TURN)])),
    "top": em.Curve.of_expressions("2*cos(2*pi*t)", "-1.5*sin(2*pi*t)"),
    "left": line(0.6, 0.0, 2.0, 0.0),
    "right": line(0.6, 0.0, 2.0, 0.0),
}


def o_grid(**changed: Any) -> em.Quadrilateral:
    return em.Quadrilateral(**(ROUND | {"closed": True} | changed))


def test_the_map_goes_on_smoothly_across_the_seam() -> None:
    domain = o_grid()
    assert closed_of(domain) == (True, False)
    assert domain.area == pytest.approx(math.pi * (3.0 - 0.18), rel=1e-5)
    t = np.linspace(0.0, 1.0, 5)
    for ahead, behind in ((domain.map, domain.map), (domain.jacobian, domain.jacobian)):
        before, after = behind(np.full(5, -1e-6), t), ahead(np.full(5, 1.0 - 1e-6), t)
        np.testing.assert_allclose(before, after, atol=1e-12)
        np.testing.assert_allclose(ahead(np.full(5, 1.0), t), behind(np.zeros(5), t), atol=1e-12)
    sharp = em.Quadrilateral(**ROUND)  # a spline with ends is not smooth there
    assert np.abs(np.subtract(sharp.jacobian(np.ones(5), t), sharp.jacobian(np.zeros(5), t))).max() > 1e-5


def test_bottom_and_top_can_be_the_seam() -> None:
    around = {
        name: em.Curve.of_expressions(f"{r}*cos(2*pi*t)", f"{r}*sin(2*pi*t)") for name, r in (("left", 1), ("right", 2))
    }
    domain = em.Quadrilateral(bottom=line(1, 0, 2, 0), top=line(1, 0, 2, 0), closed=True, **around)
    assert closed_of(domain) == (False, True)
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 5), np.linspace(-0.3, 1.3, 9), indexing="ij")
    np.testing.assert_allclose(domain.map(s, t), em.AnnulusSector(closed=True).map(s, t), atol=1e-14)


def test_a_circle_has_the_mesh_of_a_closed_ring() -> None:
    u, grid = em.Expression("tanh(6*(x - 0.3))"), em.Grid(n_xi=9, n_eta=33)
    around = {
        name: em.Curve.of_expressions(f"{r}*cos(2*pi*t)", f"{r}*sin(2*pi*t)") for name, r in (("left", 1), ("right", 2))
    }
    round_one = em.Quadrilateral(bottom=line(1, 0, 2, 0), top=line(1, 0, 2, 0), closed=True, **around)
    one, other = (
        em.solve(em.Problem(monitor=em.ArcLength(u=u), grid=grid, domain=domain), mode="tight")
        for domain in (round_one, em.AnnulusSector(closed=True))
    )
    assert one.mesh.distance(other.mesh) < 1e-11
    assert {*one.joined.sides} == {"left", "right"}


def test_a_closed_domain_without_a_seam_is_refused() -> None:
    error = refusal(o_grid, right=em.Curve.of_expressions("0.6 + 1.4*t", "0.1*sin(pi*t)"))
    assert error.field == "domain.closed"
    assert "left and right are up to 0.1 apart" in error.message
    assert refusal(o_grid, closed=1).field == "domain.closed"


def test_corners_at_the_seam_are_refused_and_blocks_are_named() -> None:
    drop = np.column_stack([0.6 * np.cos(TURN), 0.3 * np.sin(TURN) * np.sin(0.5 * TURN) ** 2])
    error = refusal(o_grid, bottom=em.Curve.through(drop))
    assert error.field == "domain.bottom"
    assert "bottom has a corner of " in error.message
    assert "(0.6, 0), where it begins and ends" in error.message
    assert "'corners', and solve on Blocks.of(...)" in error.message
    error = refusal(o_grid, top=em.Curve.of_expressions("2*cos(2*pi*t)", "-1.5*sin(2*pi*t)*(1+t)"))
    assert error.field == "domain.top"
    assert "top begins at (2, -0) with the slope" in error.message


# Areas between curved sides and their chords.


def test_the_area_of_segments_of_circles() -> None:
    """That of an arc of angle a is (a - sin a) / 2; a segment counts on either side of its chord."""
    for angle, accuracy in ((0.1, 1e-3), (1.0, 2e-2), (math.pi, 0.2)):
        t = np.multiply.outer([1.0, -1.0], angle * np.array(PLACES))
        assert areas_between(np.cos(t), np.sin(t)).sum() == pytest.approx(angle - math.sin(angle), rel=accuracy)


def test_a_whole_wave_is_seen_though_its_middle_lies_on_the_chord() -> None:
    t = np.array([PLACES])
    assert areas_between(t, np.sin(2.0 * math.pi * t)).sum() == pytest.approx(2.0 / math.pi, rel=0.1)


def test_the_sides_of_a_ring_lose_and_cover_by_the_formula() -> None:
    angles = np.linspace(0.0, 1.0, 41)
    for s, radius in ((0.0, 1.0), (1.0, 2.0)):
        line = np.stack([np.full(angles.size, s), angles])
        found = cut_off(em.AnnulusSector(angles=(0, 360)), line[:, :-1], line[:, 1:])
        step = 2.0 * math.pi / 40
        assert found == pytest.approx(20 * radius**2 * (step - math.sin(step)), rel=3e-3)


def test_the_bound_is_a_share_of_the_area_or_twice_the_initial_one() -> None:
    assert most_cut_off(0.001, 2.0) == pytest.approx(0.501)
    assert most_cut_off(0.6, 2.0) == pytest.approx(1.2)
