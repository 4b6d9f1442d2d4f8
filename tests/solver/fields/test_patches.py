"""Polynomials on rectangles are the spline of the B-splines that they are made from."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

import equimesh as em
from equimesh.fields import bicubic
from equimesh.fields.bicubic import Bicubic


def spline() -> Bicubic:
    x, y = np.linspace(0.0, 2.0, 23) ** 1.5, np.linspace(-1.0, 1.0, 17)
    values = np.random.default_rng(3).standard_normal((23, 17))
    return Bicubic.of(RectBivariateSpline(x, y, values, s=0))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_both_ways_of_evaluation_agree(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    rng = np.random.default_rng(order)
    points = rng.uniform(-0.2, 3.2, 4000), rng.uniform(-1.2, 1.2, 4000)  # some outside
    by_patches = spline().evaluate(*points, order)
    monkeypatch.setattr(bicubic, "MAX_PATCHES", 0)
    by_splines = spline().evaluate(*points, order)
    assert len(by_patches) == len(by_splines) == (1, 3, 6)[order]
    for first, second in zip(by_patches, by_splines, strict=True):
        assert np.abs(first - second).max() < 1e-12 * np.abs(second).max()
        assert (first != second).any(), "these are two ways"


def test_a_spline_that_was_used_pickles_without_its_polynomials() -> None:
    used, unused = spline(), spline()
    expected = used.evaluate(np.array([0.7]), np.array([0.2]))
    assert len(pickle.dumps(used)) == len(pickle.dumps(unused))
    assert pickle.loads(pickle.dumps(used)).evaluate(np.array([0.7]), np.array([0.2])) == expected


@pytest.mark.parametrize("order", [0, 1, 2])
def test_values_on_a_mesh_are_those_by_splines(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    start = em.Mesh.uniform(em.Grid(n_xi=20, n_eta=15))
    bump = np.sin(np.pi * start.x) * np.sin(np.pi * start.y)
    mesh = em.Mesh(start.x + 0.1 * bump, start.y - 0.08 * bump)
    values = np.tanh(5.0 * (mesh.x + mesh.y - 1.0))
    points = np.random.default_rng(order).uniform(-0.01, 1.01, (2, 500))  # some outside
    by_patches = em.NodalField(mesh=mesh, values=values).evaluate(*points, order)
    monkeypatch.setattr(bicubic, "MAX_PATCHES", 0)
    by_splines = em.NodalField(mesh=mesh, values=values).evaluate(*points, order)
    for first, second in zip(by_patches, by_splines, strict=True):
        assert np.abs(first - second).max() < 1e-11 * np.abs(second).max()
        assert (first != second).any(), "these are two ways"
