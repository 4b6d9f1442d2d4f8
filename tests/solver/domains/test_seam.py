"""O-grids between four curves: their seam, the smooth curves through it, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import closed_of
from solver.domains.shapes import line, refusal

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
