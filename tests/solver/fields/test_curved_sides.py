"""Middles of edges on the sides of domains."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.fields.curved_sides import curved_edges
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.second_order import CurvedEdges, SecondOrderMesh

GRID = Grid(n_xi=5, n_eta=9)


def bent(domain: em.Domain, shift: float = 0.0) -> Mesh:
    """A mesh of a domain with uneven spacings; with ``shift`` its seam lies elsewhere."""
    uniform = Mesh.uniform(GRID)
    return map_mesh(Mesh(uniform.x**1.3, uniform.y - 0.1 * np.sin(2 * np.pi * uniform.y) / np.pi + shift), domain)


def check_equidistant(mesh: Mesh, found: CurvedEdges, count: int) -> None:
    edges, middles = found.edges, found.middles
    assert len(edges) == count
    begin, end = (np.hypot(*(middles - mesh.points[edges[:, k]]).T) for k in (0, 1))
    np.testing.assert_allclose(begin, end, rtol=1e-9)
    lengths = np.hypot(*(mesh.points[edges[:, 1]] - mesh.points[edges[:, 0]]).T)
    assert (begin < 0.7 * lengths).all()


@pytest.mark.parametrize(
    ("domain", "shift"),
    [
        (em.AnnulusSector(angles=(10.0, 200.0)), 0.0),
        (em.AnnulusSector(closed=True), 0.0),
        (em.AnnulusSector(closed=True), 0.03),
    ],
    ids=["sector", "ring", "ring with a moved seam"],
)
def test_middles_lie_on_the_arcs_of_an_annulus(domain: em.AnnulusSector, shift: float) -> None:
    mesh = bent(domain, shift)
    found = curved_edges(mesh, domain)
    check_equidistant(mesh, found, 2 * 8)
    inner = np.isin(found.edges, mesh.sides["left"]).all(axis=1)
    np.testing.assert_allclose(np.hypot(*found.middles.T), np.where(inner, 1.0, 2.0), rtol=1e-13)


def test_a_rectangle_has_no_curved_sides() -> None:
    domain = em.Rectangle(x=(0.0, 3.0))
    assert len(curved_edges(bent(domain), domain).edges) == 0


def test_middles_lie_on_the_curve_of_a_quadrilateral_whatever_its_speed() -> None:
    domain = em.Quadrilateral(
        bottom=em.Curve.of_expressions("t**2*(2 - t)*0.9 + 0.1*t", "0.1*sin(pi*(t**2*(2 - t)*0.9 + 0.1*t))"),
        right=em.Curve.of_expressions("1", "t"),
        top=em.Curve.of_expressions("t", "1"),
        left=em.Curve.of_expressions("0", "t"),
    )
    mesh = bent(domain)
    found = curved_edges(mesh, domain)
    check_equidistant(mesh, found, 4)
    x, y = found.middles.T
    np.testing.assert_allclose(y, 0.1 * np.sin(np.pi * x), atol=1e-14)


@pytest.mark.parametrize(
    "curve",
    [
        {"circle": {"center": [0.5, 0.0], "radius": 0.5}},
        {"naca": "0012"},
        {"points": [[1, 0], [0.5, 0.3], [0, 0], [0.5, -0.3], [1, 0]], "corners": [0]},
    ],
    ids=["circle", "airfoil", "spline"],
)
def test_middles_lie_on_the_curves_of_blocks_that_close_around_them(curve: dict[str, object]) -> None:
    domain = em.Blocks.of(
        {
            "vertices": {"te": [1, 0], "far": [8.5, 0]},
            "curves": {"body": curve, "far": {"circle": {"center": [0.5, 0], "radius": 8}}},
            "edges": [{"from": "te", "to": "te", "on": "body"}, {"from": "far", "to": "far", "on": "far"}],
            "blocks": [{"corners": ["te", "far", "far", "te"], "cells": [8, 24], "grading": [60, None]}],
            "sides": {"body": [["te", "te"]]},
        }
    )
    found = curved_edges(domain.mesh, domain)
    check_equidistant(domain.mesh, found, 2 * 24)
    for one in domain.curves:
        x, y = found.middles.T
        at = one.evaluate(one.nearest(x, y))
        away = np.hypot(at[0] - x, at[1] - y) < 1e-8
        assert away.sum() == 24
    SecondOrderMesh.of(domain.mesh.points, domain.mesh.cells, found)  # no cell folds
