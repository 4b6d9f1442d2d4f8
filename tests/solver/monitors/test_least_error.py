"""The request for a least-error mesh: its values, its metric, its copies."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.testing import check_monitor
from solver.monitors.metrics import SECTOR, UNIT, points

STEEP = em.Expression("tanh(20*(x + y/2 - 0.75))")


@pytest.mark.parametrize("domain", [UNIT, SECTOR])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_it_is_a_monitor(norm: Any, domain: em.Domain) -> None:
    check_monitor(em.LeastError(u=STEEP, norm=norm), domain)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_its_metric_is_that_of_curvature(norm: Any) -> None:
    x, y = points(n=9)
    own = em.LeastError(u=STEEP, norm=norm).on(UNIT).metric(x, y)
    assert np.array_equal(own, em.Curvature(u=STEEP, norm=norm).on(UNIT).metric(x, y))


def test_the_defaults() -> None:
    monitor = em.LeastError(u=STEEP)
    assert (monitor.norm, monitor.cells, monitor.distortion, monitor.smoothness) == ("l2", "quad", 0.5, 1.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("norm", "linf"),
        ("norm", None),
        ("cells", "hexagon"),
        ("distortion", 0.0),
        ("distortion", -1.0),
        ("distortion", float("nan")),
        ("distortion", "1"),
        ("smoothness", 0.0),
        ("smoothness", 1001.0),
        ("smoothness", float("inf")),
        ("u", 3.0),
        ("u", "tanh(x"),
    ],
)
def test_what_is_refused_names_its_field(field: str, value: Any) -> None:
    with pytest.raises(em.InputError) as caught:
        em.LeastError(**({"u": STEEP} | {field: value}))
    assert caught.value.field == field


def test_the_metric_needs_a_domain_and_binding_keeps_the_rest() -> None:
    monitor = em.LeastError(u=STEEP, norm="h1", distortion=0.2, smoothness=0.3, cells="triangle")
    with pytest.raises(em.InputError, match="on\\(domain\\)"):
        monitor.metric(*points(n=2))
    bound = monitor.on(UNIT)
    assert bound == monitor
    assert bound.on(UNIT) is bound
    assert bound.on(SECTOR) is not bound
    assert pickle.loads(pickle.dumps(bound)) == monitor


@pytest.mark.parametrize(("u", "norm"), [("log(x - 0.5)", "l2"), ("sqrt(y - 0.25)", "l2"), ("(x - 0.5)**1.5", "h1")])
def test_u_must_be_finite_on_the_domain(u: str, norm: Any) -> None:
    with pytest.raises(em.InputError) as caught:
        em.LeastError(u=em.Expression(u), norm=norm).on(UNIT)
    assert caught.value.field == "u"


@pytest.mark.parametrize("factor", [1e300, 1e145, 1e-145, 1e-310])
def test_squares_of_u_must_be_numbers(factor: float) -> None:
    with pytest.raises(em.InputError, match="multiply u by a constant") as caught:
        em.LeastError(u=em.Expression(f"{factor!r}*(x + 2)")).on(UNIT)
    assert caught.value.field == "u"
    em.LeastError(u=em.Expression("0*x")).on(UNIT)
    em.LeastError(u=em.Expression(f"{factor**0.3!r}*(x + 2)")).on(UNIT)
