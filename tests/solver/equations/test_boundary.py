"""Sides of the unit square as conditions: where their nodes lie, and the metric lengths of their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.problem import SideLine, sides

WEIGHT = em.Weight(rho=em.Expression("1 + x*y + 3*exp(-9*(x - y)**2)"))
SECTOR = em.AnnulusSector(angles=(5, 85))
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


@pytest.mark.parametrize("domain", [em.Rectangle(), SECTOR], ids=["square", "sector"])
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
