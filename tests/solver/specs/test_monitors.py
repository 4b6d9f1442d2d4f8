"""Monitors of a document."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from equimesh import (
    ArcLength,
    Auto,
    Curvature,
    Expression,
    InputError,
    Intersection,
    LeastError,
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
    "arc length": ({"kind": "arc_length", "u": U}, ArcLength(u=FIELD)),
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
def test_every_metric_is_built(name: str) -> None:
    document, monitor = PLAIN[name]
    assert build_monitor(document, SQUARE, no_samples) == monitor.on(SQUARE)
    smooth = build_monitor({**document, "smoothing": 0.1}, SQUARE, no_samples)
    assert smooth == Smoothed(monitor=monitor, radius=0.1).on(SQUARE)
    both = {"kind": "intersection", "monitors": [document, {"kind": "weight", "rho": ONE}]}
    expected = Intersection(monitors=(monitor, Weight(rho=FLAT)))
    assert build_monitor(both, SQUARE, no_samples) == expected.on(SQUARE)


MEASURED: dict[str, tuple[dict[str, Any], Monitor]] = {
    "no kind": ({"u": U}, Auto(u=FIELD)),
    "auto": ({"kind": "auto", "u": U, "norm": "h1"}, Auto(u=FIELD, norm="h1")),
    "least error": ({"kind": "least_error", "u": U}, LeastError(u=FIELD)),
    "weights": (
        {"kind": "least_error", "u": "x*y", "norm": "h1", "distortion": 1, "smoothness": 0.1},
        LeastError(u=FIELD, norm="h1", distortion=1, smoothness=0.1),
    ),
}


@pytest.mark.parametrize("name", MEASURED)
def test_monitors_that_measure_the_error_take_the_cells_of_the_file(name: str) -> None:
    document, monitor = MEASURED[name]
    assert build_monitor(document, SQUARE, no_samples) == monitor.on(SQUARE)
    triangles = build_monitor(document, SQUARE, no_samples, cells="triangle")
    assert triangles == replace(monitor, cells="triangle").on(SQUARE)  # type: ignore[type-var]


def test_a_member_of_an_intersection_without_a_kind_is_an_arc_length() -> None:
    both = {"kind": "intersection", "monitors": [{"u": U}, {"u": "x*y", "a": 0.5}]}
    expected = Intersection(monitors=(ArcLength(u=FIELD), ArcLength(u=FIELD, a=0.5)))
    assert build_monitor(both, SQUARE, no_samples) == expected.on(SQUARE)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"u": U, "smoothing": 0.1}, "smoothing averages a metric"),
        ({"u": U, "a": 0.5}, "add kind arc_length"),
        ({"kind": "least_error", "u": U, "smoothing": 0}, "smoothing averages a metric"),
        ({"kind": "least_error", "norm": "l2"}, "needs the key 'u'"),
        ({"kind": "least_error", "u": U, "distortion": 0}, "must be positive"),
    ],
)
def test_what_a_measured_error_has_no_use_for_is_refused_with_the_reason(document: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        build_monitor(document, SQUARE, no_samples)


@pytest.mark.parametrize(
    ("document", "field"),
    [
        ({}, "monitor.u"),
        ({"u": "x+*y"}, "monitor.u"),
        ({"kind": "auto", "u": U, "norm": "max"}, "monitor.norm"),
        ({"kind": "least_error", "u": U, "smoothness": -1}, "monitor.smoothness"),
        ({"kind": "least_error", "u": U, "smoothness": "1"}, "monitor.smoothness"),
        ({"kind": "intersection", "monitors": [{"u": U}, {"kind": "auto", "u": U}]}, "monitor.monitors.1.kind"),
        ({"kind": "magic"}, "monitor.kind"),
        ({"kind": "arc_length", "u": U, "a": "1"}, "monitor.a"),
        ({"kind": "arc_length", "u": U, "a": 2}, "monitor.a"),
        ({"u": U, "rho": ONE}, "monitor.rho"),
        ({"u": {"expression": "foo"}}, "monitor.u.expression"),
        ({"kind": "curvature", "u": U, "norm": ["l2"]}, "monitor.norm"),
        ({"kind": "curvature", "u": U, "isotropic": 1}, "monitor.isotropic"),
        ({"kind": "weight", "rho": {"expression": "x-1"}}, "monitor.rho"),
        ({"kind": "arc_length", "u": U, "smoothing": 1}, "monitor.smoothing"),
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
