"""Weights and tensors that the user gives: refused with the place where they are not positive definite."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import STEEP, UNIT


@pytest.mark.parametrize(
    ("rho", "message"),
    [
        ("x + y - 0.5", r"rho = -0\.5 at \(x, y\) = \(0, 0\).*positive"),
        ("1 - exp(-30*((x - 0.25)**2 + (y - 0.75)**2))", r"rho = 0 at \(x, y\) = \(0\.25, 0\.75\)"),
        ("1/(x - 1)**2", r"rho is not finite at \(x, y\) = \(1, 0\)"),
    ],
)
def test_a_weight_that_is_not_positive_is_refused_with_the_place(rho: str, message: str) -> None:
    with pytest.raises(em.InputError, match=message) as caught:
        em.Weight(rho=em.Expression(rho)).on(UNIT)
    assert caught.value.field == "rho"


@pytest.mark.parametrize(
    ("entries", "message", "field"),
    [
        (("1", "2*x", "1"), r"\[\[1, 2\], \[2, 1\]\] at \(x, y\) = \(1, 0\).*smallest eigenvalue is -1;", "m12"),
        (("y - 0.5", "0", "1"), r"at \(x, y\) = \(0, 0\).*smallest eigenvalue is -0\.5;", "m11"),
        (("1", "0", "-1"), r"smallest eigenvalue is -1;", "m22"),
        (("1", "1", "1"), r"smallest eigenvalue is 0;", "m12"),
        (("1", "log(x)", "1"), r"m12 is not finite at \(x, y\) = \(0, 0\)", "m12"),
    ],
)
def test_a_tensor_that_is_not_positive_definite_is_refused_with_the_place(
    entries: tuple[str, str, str], message: str, field: str
) -> None:
    m11, m12, m22 = (em.Expression(entry) for entry in entries)
    tensor = em.Tensor(m11=m11, m12=m12, m22=m22)
    with pytest.raises(em.InputError, match=message) as caught:
        tensor.on(UNIT)
    assert caught.value.field == field
    nested = em.Intersection(monitors=(em.ArcLength(u=STEEP), em.Smoothed(monitor=tensor)))
    with pytest.raises(em.InputError, match=message) as caught:
        nested.on(UNIT)
    assert caught.value.field == f"monitors.1.{field}"


def test_a_tensor_is_checked_on_its_domain_and_not_elsewhere() -> None:
    weight = em.Weight(rho=em.Expression("x - 1"))
    assert weight.on(em.Rectangle(x=(1.5, 2.0))).metric(np.array([1.75]), np.array([0.0]))[0] == 0.75
    with pytest.raises(em.InputError, match="rho"):
        weight.on(UNIT)


def test_an_unknown_map_of_a_weight_is_refused() -> None:
    with pytest.raises(em.InputError, match="choose 'lines' or 'gradient'") as caught:
        em.Weight(rho=em.Expression("1"), map="rows")  # type: ignore[arg-type]
    assert caught.value.field == "map"


def test_a_weight_at_nodes_does_not_overshoot() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    values = np.where(nodes.x < 0.4, 1e-3, 1.0)
    spline = em.NodalField(mesh=nodes, values=values)
    x, y = np.meshgrid(*[np.linspace(0.0, 1.0, 81)] * 2, indexing="ij")
    assert spline.evaluate(x, y)[0].min() < 0.0  # what a weight cannot be
    rho = em.Weight(rho=spline).on(em.Rectangle()).metric(x, y)[0]
    assert rho.min() == pytest.approx(1e-3, rel=1e-6)
    assert rho.max() == pytest.approx(1.0, rel=1e-6)
