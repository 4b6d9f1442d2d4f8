"""Monitors of the client: their JSON, and which u goes where."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import ArcLength, Auto, BadArgument, Curvature, Intersection, LeastError, Tensor, Weight
from equimesh_client.spec.request import monitor_json


def read(function: object) -> dict[str, Any]:
    return {"expression": function}


X, Y = read("x"), read("y")
# the monitor, the u of `generate`, the JSON
GOOD: list[tuple[Any, Any, dict[str, Any]]] = [
    (Auto(), "x", {"kind": "auto", "u": X, "norm": "l2"}),
    (
        LeastError(norm="h1", smoothness=0.3, u="y"),
        None,
        {"kind": "least_error", "u": Y, "norm": "h1", "distortion": 0.5, "smoothness": 0.3},
    ),
    (ArcLength(), "x", {"kind": "arc_length", "u": X, "a": 0.7, "b": 0.05}),
    (
        ArcLength(a=0.5, smoothing=0.1, u="y"),
        None,
        {"kind": "arc_length", "u": Y, "a": 0.5, "b": 0.05, "smoothing": 0.1},
    ),
    (ArcLength(scaled=False), "x", {"kind": "arc_length", "u": X, "a": 0.7, "b": 0.05, "scaled": False}),
    (Curvature(norm="h1"), "x", {"kind": "curvature", "u": X, "norm": "h1", "isotropic": False}),
    (Weight("y"), None, {"kind": "weight", "rho": Y, "map": "lines"}),
    (
        Weight("y", smoothing=0.2, map="gradient"),
        "x",
        {"kind": "weight", "rho": Y, "u": X, "map": "gradient", "smoothing": 0.2},
    ),
    (Tensor("x", "0", "y"), None, {"kind": "tensor", "m11": X, "m12": read("0"), "m22": Y}),
    ({"kind": "curvature"}, "x", {"kind": "curvature", "u": X}),
    ({"kind": "weight", "rho": X}, None, {"kind": "weight", "rho": X}),
    (
        Intersection([Curvature(), Weight("y"), ArcLength(u="y")]),
        "x",
        {
            "kind": "intersection",
            "monitors": [
                {"kind": "curvature", "u": X, "norm": "l2", "isotropic": False},
                {"kind": "weight", "rho": Y, "map": "lines"},
                {"kind": "arc_length", "u": Y, "a": 0.7, "b": 0.05},
            ],
        },
    ),
    (
        Intersection([Weight("x"), Weight("y")], smoothing=0.1),
        "x",
        {
            "kind": "intersection",
            "monitors": [
                {"kind": "weight", "rho": X, "u": X, "map": "lines"},
                {"kind": "weight", "rho": Y, "map": "lines"},
            ],
            "smoothing": 0.1,
        },
    ),
]


@pytest.mark.parametrize(("monitor", "u", "json"), GOOD)
def test_monitors_as_json(monitor: Any, u: Any, json: dict[str, Any]) -> None:
    assert monitor_json(monitor, read, u) == json


@pytest.mark.parametrize(
    ("monitor", "u", "words"),
    [
        (ArcLength(), None, "give u"),
        (Curvature(), None, "give u"),
        (Auto(), None, "Auto needs a function u"),
        (LeastError(u="x"), "y", "twice"),
        (Intersection([ArcLength(), Auto()]), "x", "at the top an Auto"),  # type: ignore[list-item]
        (ArcLength(u="x"), "y", "twice"),
        (Weight("x", u="x"), "y", "twice"),
        ({"kind": "weight", "u": X}, "y", "twice"),
        (Intersection([ArcLength(), Weight("x")]), None, "give u"),
        (Intersection([ArcLength(u="x"), ArcLength(u="y")]), "x", "not used"),
        (
            Intersection([Intersection([]), Weight("x")]),
            None,
            "an NodalSolution or an Intersection",
        ),
        (Intersection(3), "x", "list of monitors"),  # type: ignore[arg-type]
        ("curvature", "x", "a monitor is"),
    ],
)
def test_what_is_refused(monitor: Any, u: Any, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        monitor_json(monitor, read, u)
