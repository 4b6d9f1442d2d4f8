"""The gain of quadratic elements: against errors by many points, and on meshes where it is known."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.quality import interpolation
from equimesh.quality.cells import BilinearCells, UniformCells
from equimesh.quality.interpolation import quadratic_gain
from solver.quality.handmade import uniform, wavy

SMOOTH = em.Expression("sin(5*x)*cos(4*y)")


def gain(mesh: em.Mesh, u: em.Field = SMOOTH) -> float:
    return quadratic_gain(BilinearCells(mesh), BilinearCells(uniform(*mesh.x.shape)), u, 1.0)


def plain(mesh: em.Mesh, u: em.Field, points: int = 12) -> float:
    """The L2 error of the biquadratic interpolant, by midpoints, one cell at a time."""
    middles, square = (np.arange(points) + 0.5) / points, 0.0
    for i in range(mesh.grid.n_xi - 1):
        for j in range(mesh.grid.n_eta - 1):
            x, y = (q[i : i + 2, j : j + 2] for q in (mesh.x, mesh.y))

            def at(q: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
                return np.stack([1 - s, s], axis=1) @ q @ np.stack([1 - t, t])

            nodes = np.array([0.0, 0.5, 1.0])
            values = u.evaluate(at(x, nodes, nodes), at(y, nodes, nodes))[0]
            shape = np.stack([np.polyval(np.polyfit(nodes, row, 2), middles) for row in np.eye(3)], axis=1)
            error = shape @ values @ shape.T - u.evaluate(at(x, middles, middles), at(y, middles, middles))[0]
            along_s, along_t = np.stack([x[1] - x[0], y[1] - y[0]]), np.stack([x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]])
            s_part = along_s[:, :1] * (1 - middles) + along_s[:, 1:] * middles
            t_part = along_t[:, :1] * (1 - middles) + along_t[:, 1:] * middles
            det = np.outer(t_part[1], s_part[0]) - np.outer(t_part[0], s_part[1])
            square += float(np.sum(det * error**2)) / points**2
    return float(np.sqrt(square))


def test_it_is_the_ratio_of_errors_by_many_points() -> None:
    mesh = wavy(12, 9)
    expected = plain(uniform(12, 9), SMOOTH) / plain(mesh, SMOOTH)
    assert expected < 0.9
    assert gain(mesh) == pytest.approx(expected, rel=0.02)


def test_it_is_one_on_the_uniform_mesh_and_for_a_quadratic() -> None:
    assert gain(uniform(20, 40)) == 1.0
    assert gain(wavy(33, 33), em.Expression("x**2 - 3*x*y + 2*y**2 + 1")) == 1.0


def test_scattered_cells_give_nearly_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    some = gain(wavy(65, 65))
    monkeypatch.setattr(interpolation, "MEASURED_CELLS", 10**6)
    assert some != gain(wavy(65, 65))
    assert some == pytest.approx(gain(wavy(65, 65)), rel=0.05)


def test_few_points_are_evaluated() -> None:
    points = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            points.append(x.size)
            return SMOOTH.evaluate(x, y, order)

    mesh = wavy(129, 129)
    plainly = UniformCells(mesh.grid, em.Rectangle())
    quadratic_gain(BilinearCells(mesh), plainly, Counting(), 1.0)  # type: ignore[arg-type]
    assert sum(points) <= 2 * 18 * 257
