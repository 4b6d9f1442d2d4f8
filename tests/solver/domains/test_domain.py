"""What every domain promises of its map, area and box; rectangles and sectors in particular."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from solver.domains.shapes import DOMAINS, S, T, refusal

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
