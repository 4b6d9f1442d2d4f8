"""The solution of degree 2 on the cells of a mesh."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.testing.geometries import disc, l_shape
from equimesh_coupling import biquadratic
from equimesh_coupling.biquadratic import Equation, PlacesFunction, functional_of_degree_2
from equimesh_coupling.functionals import place_of_point, places_in_region, places_on_side
from equimesh_coupling.recovery import unique_edges

X, Y = np.meshgrid(np.linspace(0.0, 1.0, 6) ** 1.5, np.linspace(0.0, 1.0, 5), indexing="ij")
PARTS = em.Mesh(X + 0.05 * np.sin(np.pi * X) * np.sin(np.pi * Y), Y).mesh_parts("quad")


def quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """It has no slope along x at x = 1."""
    return (x - 1.0) ** 2 + 2.0 * y**2


def source(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return -6.0 * 0.5 + 2.0 * 2.0 * (x - 1.0) + 4.0 * y + 3.0 * quadratic(x, y)


@pytest.mark.parametrize(
    ("places", "value"),
    [
        (lambda parts: place_of_point(parts, 0.4, 0.3), quadratic(np.array(0.4), np.array(0.3))),
        (lambda parts: places_in_region(parts, None), 1.0),
        (lambda parts: places_on_side(parts, "right"), 2.0 / 3.0),
    ],
    ids=["point", "integral", "side"],
)
def test_a_quadratic_solution_is_exact_with_values_given_and_without_flux(places: PlacesFunction, value: float) -> None:
    equation = Equation(diffusion=0.5, stream=(2.0, 1.0), reaction=3.0, source=source)
    x, y = PARTS.points.T
    is_fixed = (x < 1e-9) | (y < 1e-9) | (y > 1.0 - 1e-9)
    u = np.where(is_fixed, quadratic(x, y), 7.0)
    assert functional_of_degree_2(PARTS, equation, places, u, is_fixed) == pytest.approx(value, abs=1e-10)


def singular(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Harmonic, zero on both sides of the corner of the L, whose quadrant x > 0, y < 0 is missing."""
    return np.hypot(x, y) ** (2.0 / 3.0) * np.sin(2.0 / 3.0 * np.mod(np.arctan2(y, x), 2.0 * np.pi))


def test_nodes_at_a_quarter_see_the_slopes_at_a_corner(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = l_shape(100).mesh
    parts = mesh.mesh_parts("quad")
    edges, numbers = unique_edges(parts.cells)
    outer = edges[np.bincount(numbers.ravel()) == 1]
    is_fixed = np.zeros(len(parts.points), dtype=bool)
    is_fixed[outer] = True
    (corner,) = biquadratic.steep_corners(parts, outer, is_fixed[outer].all(axis=1))
    assert parts.points[corner] == pytest.approx(0.0, abs=1e-12)
    equation = Equation(diffusion=1.0, stream=(0.0, 0.0), reaction=0.0, source=0.0)
    u, exact, errors = singular(*parts.points.T), float(singular(np.array(-0.4), np.array(0.3))), []
    for near in (0.5, biquadratic.NEAR_CORNER):
        monkeypatch.setattr(biquadratic, "NEAR_CORNER", near)
        found = functional_of_degree_2(parts, equation, lambda of: place_of_point(of, -0.4, 0.3), u, is_fixed)
        errors.append(abs(found - exact))
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize(
    ("of", "exact"),
    [
        (lambda parts: place_of_point(parts, 0.4, 0.3), math.sin(0.4 * math.pi) * math.sin(0.3 * math.pi)),
        ("left", -2.0),
    ],
    ids=["point", "flux"],
)
def test_halved_cells_have_the_order_of_degree_2(of: Any, exact: float, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 2.0 * math.pi**2 * np.sin(math.pi * x) * np.sin(math.pi * y)

    parts = em.Mesh.uniform(em.Grid(9)).mesh_parts("quad")
    is_fixed = (np.abs(parts.points - 0.5) > 0.499).any(axis=1)
    equation, errors = Equation(diffusion=1.0, stream=(0.0, 0.0), reaction=0.0, source=load), []
    for most in (0, biquadratic.MAX_HALVED):
        monkeypatch.setattr(biquadratic, "MAX_HALVED", most)
        errors.append(abs(functional_of_degree_2(parts, equation, of, np.zeros(len(parts.points)), is_fixed) - exact))
    assert errors[1] < 0.15 * errors[0]


def test_halved_sides_go_on_along_the_same_curves_in_the_same_direction() -> None:
    parts = disc(200).mesh.mesh_parts("quad")
    (name, ends), *_ = parts.sides.items()
    is_fixed = np.isin(np.arange(len(parts.points)), np.concatenate(list(parts.sides.values())))
    found, values, known = biquadratic.halved(parts, parts.points[:, 0], is_fixed)
    assert len(found.cells) == 4 * len(parts.cells)
    assert found.sides[name][::2, 0].tolist() == ends[:, 0].tolist()
    assert found.sides[name][1::2, 1].tolist() == ends[:, 1].tolist()
    assert (found.sides[name][::2, 1] == found.sides[name][1::2, 0]).all()
    assert np.hypot(*found.points[found.sides[name].ravel()].T) == pytest.approx(1.0, abs=1e-3)
    assert values[known] == pytest.approx(found.points[known, 0], abs=1e-12)
    assert known.sum() == 2 * is_fixed.sum()
