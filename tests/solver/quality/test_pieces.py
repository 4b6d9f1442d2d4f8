"""Integrals of interpolation errors over pieces of cells."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.quality.cells import BilinearCells
from equimesh.quality.resolution import Pieces
from solver.quality.handmade import wavy


def of(mesh: em.Mesh, u: em.Expression) -> Pieces:
    cells = BilinearCells(mesh)
    numbers = np.arange(cells.count)
    return Pieces.of(cells, numbers, cells.corner_values(u.evaluate(*cells.nodes)[0], numbers))


def test_the_quarters_of_a_cell_have_its_area_and_its_interpolant() -> None:
    u = em.Expression("sin(3*x)*y")
    whole = of(wavy(5, 4), u)
    quarters = whole.quarters()
    assert quarters.count == 4 * whole.count

    def areas(pieces: Pieces) -> np.ndarray:
        x, y = pieces.corners[:4], pieces.corners[4:]
        return 0.5 * ((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0]))

    assert areas(quarters).reshape(4, -1).sum(axis=0) == pytest.approx(areas(whole))
    assert (areas(quarters) > 0.0).all()
    # the corner that the four quarters share is the centre, where the interpolant is the mean of the corners
    for values in (quarters.values[2, : whole.count], quarters.values[0, 2 * whole.count : 3 * whole.count]):
        assert values == pytest.approx(whole.values.mean(axis=0))
    together = quarters.errors(u)[:2].reshape(2, 4, -1).sum(axis=1)
    assert together == pytest.approx(whole.errors(u)[:2], rel=1e-4)


def test_errors_of_a_square_by_hand() -> None:
    # u = y^2 on cells of height h: the square of u - u_h has the integral h^4/30, that of its gradient h^2/3
    u = em.Expression("y**2")
    found = of(em.Mesh.uniform(em.Grid(n_xi=5, n_eta=11)), u).errors(u).sum(axis=1)
    assert found[:2] == pytest.approx([1e-4 / 30, 1e-2 / 3], rel=1e-12)
    assert found[2] == pytest.approx(0.0, abs=1e-15)


def test_a_jump_is_missed_by_the_gradient_and_seen_on_the_rim() -> None:
    mesh = wavy(9, 9)
    for u, missed in (("where(x + y < 0.9, 0, 1)", 0.5), ("exp(-x/1e-7)", 0.5), ("tanh(4*(x - y))", 0.0)):
        _, square, lost = of(mesh, em.Expression(u)).errors(em.Expression(u)).sum(axis=1)
        assert (lost > missed * square) if missed else (lost < 0.02 * square), u


def test_blocks_do_not_change_the_errors() -> None:
    u = em.Expression("tanh(9*(x - y))")
    pieces = of(wavy(60, 50), u)
    assert pieces.count > 2 * 1024
    some = np.arange(5, pieces.count, 7)
    assert pieces.some(some).errors(u) == pytest.approx(pieces.errors(u)[:, some], rel=1e-13)
