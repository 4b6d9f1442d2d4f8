"""Monitors and functions of a document."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh import (
    ArcLength,
    Auto,
    Curvature,
    Expression,
    GridSamples,
    InputError,
    Intersection,
    LeastError,
    Monitor,
    Rectangle,
    SamplesError,
    ScatteredSamples,
    Smoothed,
    Tensor,
    Weight,
)
from equimesh.specs import build_expression, build_field, no_samples, samples_in
from equimesh.specs.monitors import build_monitor

# Monitors of a document.


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


def test_the_degree_of_the_elements_is_read() -> None:
    read = build_monitor({"kind": "least_error", "u": U, "degree": 2}, SQUARE, no_samples, cells="triangle")
    assert read == LeastError(u=FIELD, degree=2, cells="triangle").on(SQUARE)
    assert build_monitor({"u": U, "degree": 4}, SQUARE, no_samples) == Auto(u=FIELD, degree=4).on(SQUARE)


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


# Functions of x and y in a document.


WIDE = Rectangle(x=(0, 2))
GRID: dict[str, Any] = {"x": [0, 1, 2], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 2]]}
SCATTERED: dict[str, Any] = {"points": [[0, 0], [2, 0], [0, 1], [2, 1], [0.9, 0.6]], "values": [0, 1, 2, 3, 4]}


def test_every_source_is_built(tmp_path: Path) -> None:
    np.savez(tmp_path / "u.npz", **GRID)
    find = samples_in(tmp_path)
    expression = {"expression": "k*x + t", "parameters": {"k": 3}, "t": 2}
    assert build_field(expression, WIDE, find) == Expression("k*x + t", parameters={"k": 3}, t=2)
    assert build_expression(expression, WIDE) == build_field(expression, WIDE, find)
    found = (build_field(source, WIDE, find) for source in ({"grid": GRID}, {"samples": "u.npz"}))
    for field in found:
        assert isinstance(field, GridSamples)
        assert field.box == WIDE.box
    assert isinstance(build_field({"scattered": SCATTERED}, WIDE, find), ScatteredSamples)


def test_a_name_tells_the_column_of_a_file(tmp_path: Path) -> None:
    rows = [f"{x} {y} {x * y} {x}" for x in (0, 1, 2) for y in (0, 1)]
    (tmp_path / "flow.txt").write_text("\n".join(["x y T p", *rows]))
    (tmp_path / "odd#p.txt").write_text("\n".join(["x y q", *(row.rpartition(" ")[0] for row in rows)]))
    for name, corner in (("flow.txt#T", 2.0), ("flow.txt#p", 2.0), ("odd#p.txt", 2.0)):
        field = build_field({"samples": name}, WIDE, samples_in(tmp_path))
        assert field.evaluate(np.array(2.0), np.array(1.0))[0] == pytest.approx(corner)
    p = build_field({"samples": "flow.txt#p"}, WIDE, samples_in(tmp_path))
    assert p.evaluate(np.array(2.0), np.array(0.0))[0] == pytest.approx(2.0)
    with pytest.raises(SamplesError, match="choose u from T, p") as caught:
        build_field({"samples": "flow.txt"}, WIDE, samples_in(tmp_path), "monitor.u")
    assert caught.value.columns == ("T", "p")
    (tmp_path / "u.zarr").mkdir()
    with pytest.raises(SamplesError, match="has no columns"):
        build_field({"samples": "u.zarr#T"}, WIDE, samples_in(tmp_path))


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(SamplesError, match="No such file") as caught:
        build_field({"samples": "u.npz"}, WIDE, samples_in(tmp_path), "monitor.u")
    assert caught.value.field == "monitor.u.samples"


def test_a_text_is_an_expression() -> None:
    assert build_field("tanh(20*x)", WIDE, no_samples) == Expression("tanh(20*x)")
    with pytest.raises(InputError) as caught:
        build_field("tanh(20*x", WIDE, no_samples, "monitor.u")
    assert caught.value.field == "monitor.u"
