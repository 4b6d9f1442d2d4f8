"""Scattered samples: accuracy, what is exact, and what the grid that they are resampled on looks like."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.scattered_samples import ScatteredSamples
from solver.domains.shapes import S, T
from solver.fields.tables import BOX, CORNERS, PROBE, errors, on_box, paper, refusal, scattered_points


class TestOnABox:
    @pytest.mark.parametrize("centred", [True, False])
    def test_scattered_samples_on_a_box(self, centred: bool) -> None:
        def error(m: int) -> float:
            p, q = (np.arange(4 * m) + 0.5) / m + 10, (np.arange(m) + 0.5) / m - 2
            if not centred:
                p, q = np.linspace(10, 14, 4 * m + 1), np.linspace(-2, -1, m + 1)
            points = np.column_stack([part.ravel() for part in np.meshgrid(p, q)])
            field = em.ScatteredSamples(points=points, values=on_box(*points.T), box=BOX)
            assert field.grid.box == BOX
            assert field.grid.x.size == pytest.approx(4 * field.grid.y.size, rel=0.1)  # as dense along x as along y
            x, y = 10 + 4 * S, -2 + T
            return float(np.abs(field.evaluate(x, y)[0] - on_box(x, y)).max())

        coarse, fine = error(10), error(40)
        assert fine < 0.15 * coarse
        assert fine < 2e-3

    def test_scattered_samples_that_leave_out_a_corner_are_refused(self) -> None:
        corners = np.array([[10, -2], [14, -2], [10, -1], [13, -1]])
        error = refusal(em.ScatteredSamples, points=corners, values=np.ones(4), box=BOX)
        assert error.field == "points"
        assert "(14, -1) lies outside their convex hull" in error.message
        assert "cover the box [10, 14] x [-2, -1] of the domain; add samples" in error.message


class TestAccuracy:
    def test_samples_that_stop_before_the_sides_are_continued_to_them(self) -> None:
        """Cell centres, and points at random with only the corners on the sides: errors fall with the spacing."""

        def centres(m: int) -> np.ndarray:
            axis = (np.arange(m) + 0.5) / m
            return np.column_stack([q.ravel() for q in np.meshgrid(axis, axis)])

        def strewn(m: int) -> np.ndarray:
            return np.vstack([CORNERS, np.random.default_rng(5).random((m * m, 2))])

        for points_of in (centres, strewn):
            coarse, fine = (
                errors(ScatteredSamples(points=p, values=paper(*p.T)[0]))[0] for p in map(points_of, (24, 96))
            )
            assert fine < 0.15 * coarse
            assert fine < 0.02

    def test_scattered_samples_measured(self) -> None:
        found = np.array(
            [errors(ScatteredSamples(points=p, values=paper(*p.T)[0])) for p in map(scattered_points, (500, 8000))]
        )
        # measured at 8000: largest error 3.4e-3, mean square 1.1e-4, gradient 1.1 of 15
        assert found[1, 0] < 1e-2
        assert found[1, 2] < 3e-4
        assert found[1, 1] < 3
        halvings = 2  # spacing goes with 1 / sqrt(n)
        orders = np.log2(found[0] / found[1]) / halvings
        assert orders[2] > 1.5
        assert orders[1] > 0.5


class TestScattered:
    def test_linear_functions_are_exact(self) -> None:
        points = scattered_points(200)
        field = ScatteredSamples(points=points, values=1e-9 * (2 + points @ [3, -1]))
        u, u_x, u_y = field.evaluate(*PROBE, 1)
        np.testing.assert_allclose(u, 1e-9 * (2 + 3 * PROBE[0] - PROBE[1]), atol=1e-15)
        np.testing.assert_allclose(u_x, 3e-9, atol=1e-13)
        np.testing.assert_allclose(u_y, -1e-9, atol=1e-13)

    def test_the_grid_follows_the_number_of_samples_in_the_square(self) -> None:
        points = scattered_points(2500)
        inside = len(points)
        far = np.add(0.4 * points, [1.05, 0.0])
        field = ScatteredSamples(points=np.concatenate([far, points]), values=np.zeros(2 * inside))
        assert field.grid.x.size == round(2 * np.sqrt(inside))
        assert ScatteredSamples(points=CORNERS, values=np.ones(4)).grid.x.size == 16

    def test_repeated_points_with_the_same_value_count_once(self) -> None:
        points = scattered_points(50)
        values = np.sin(points[:, 0])
        once = ScatteredSamples(points=points, values=values)
        twice = ScatteredSamples(points=np.tile(points, (2, 1)), values=np.tile(values, 2))
        np.testing.assert_allclose(once.grid.evaluate(*PROBE)[0], twice.grid.evaluate(*PROBE)[0], atol=2e-3)

    def test_a_hull_that_misses_the_square_by_rounding_is_accepted(self) -> None:
        points = 0.5 + (1 - 1e-9) * (scattered_points(100) - 0.5)
        field = ScatteredSamples(points=points, values=points[:, 0])
        np.testing.assert_allclose(field.evaluate(*PROBE)[0], PROBE[0], atol=1e-7)
