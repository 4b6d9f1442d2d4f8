"""Monitors of a document."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh import (
    ArcLength,
    Curvature,
    Expression,
    InputError,
    Intersection,
    Monitor,
    Rectangle,
    Smoothed,
    Tensor,
    Weight,
)
from equimesh.specs import no_samples
from equimesh.specs.monitors import build_monitor

U, ONE = {"expression": "x*y"}, {"expression": "1"}
FIELD, FLAT = Expression("x*y"), Expression("1")
SQUARE = Rectangle()
PLAIN: dict[str, tuple[dict[str, Any], Monitor]] = {
    "arc length": ({"u": U}, ArcLength(u=FIELD)),
    "settings": ({"kind": "arc_length", "u": U, "a": 1, "b": 0, "smoothing": 0}, ArcLength(u=FIELD, a=1, b=0)),
    "curvature": (
        {"kind": "curvature", "u": U, "norm": "h1", "isotropic": True},
        Curvature(u=FIELD, norm="h1", isotropic=True),
    ),
    "weight": ({"kind": "weight", "rho": ONE, "u": None}, Weight(rho=FLAT)),
    "weight with u": ({"kind": "weight", "rho": ONE, "u": U}, Weight(rho=FLAT, u=FIELD)),
    "tensor": ({"kind": "tensor", "m11": ONE, "m12": {"expression": "0"}, "m22": ONE, "u": U},
               Tensor(m11=FLAT, m12=Expression("0"), m22=FLAT, u=FIELD)),
}  # fmt: skip


@pytest.mark.parametrize("name", PLAIN)
def test_every_monitor_is_built(name: str) -> None:
    document, monitor = PLAIN[name]
    assert build_monitor(document, SQUARE, no_samples) == monitor.on(SQUARE)
    smooth = build_monitor({**document, "smoothing": 0.1}, SQUARE, no_samples)
    assert smooth == Smoothed(monitor=monitor, radius=0.1).on(SQUARE)
    both = {"kind": "intersection", "monitors": [document, {"kind": "weight", "rho": ONE}]}
    expected = Intersection(monitors=(monitor, Weight(rho=FLAT)))
    assert build_monitor(both, SQUARE, no_samples) == expected.on(SQUARE)


@pytest.mark.parametrize(
    ("document", "field"),
    [
        ({}, "monitor.u"),
        ({"kind": "magic"}, "monitor.kind"),
        ({"u": U, "a": "1"}, "monitor.a"),
        ({"u": U, "a": 2}, "monitor.a"),
        ({"u": U, "rho": ONE}, "monitor.rho"),
        ({"u": {"expression": "foo"}}, "monitor.u.expression"),
        ({"kind": "curvature", "u": U, "norm": ["l2"]}, "monitor.norm"),
        ({"kind": "curvature", "u": U, "isotropic": 1}, "monitor.isotropic"),
        ({"kind": "weight", "rho": {"expression": "x-1"}}, "monitor.rho"),
        ({"u": U, "smoothing": 1}, "monitor.smoothing"),
        ({"kind": "intersection", "monitors": [{"u": U}]}, "monitor.monitors"),
        ({"kind": "intersection", "monitors": {"u": U}}, "monitor.monitors"),
        ({"kind": "intersection", "monitors": [{"u": U}, {"kind": "intersection"}]}, "monitor.monitors.1.kind"),
        ({"kind": "intersection", "monitors": [{"u": U}, {"u": U, "smoothing": 1}]}, "monitor.monitors.1.smoothing"),
        (
            {"kind": "intersection", "monitors": [{"u": U}, {"kind": "weight", "rho": {"expression": "x-1"}}]},
            "monitor.monitors.1.rho",
        ),
    ],
)
def test_a_fault_has_the_path_of_the_document(document: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_monitor(document, SQUARE, no_samples)
    assert caught.value.field == field
