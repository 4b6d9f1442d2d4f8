"""Bad monitors are refused with the place of the mistake."""

from __future__ import annotations

import httpx
import pytest

from service.conftest import small
from service.spec.bad_specs import (
    ARC,
    GRID,
    ONE,
    WEIGHT,
    Refusal,
    X,
    both,
    expect_refusal,
    monitor,
)

MONITORS: dict[str, Refusal] = {
    "no monitor": ({}, "/monitor", "required"),
    "null monitor": ({"monitor": None}, "/monitor", ""),
    "other monitor": (small(monitor={"kind": "magic", "u": {"expression": "x"}}), "/monitor/kind", "arc_length"),
    "other norm": (monitor("curvature", u=X, norm="l3"), "/monitor/norm", "'l2' or 'h1'"),
    "text for isotropic": (monitor("curvature", u=X, isotropic="yes"), "/monitor/isotropic", "true or false"),
    "least error without u": (monitor("least_error", norm="h1"), "/monitor/u", "the norm is that of the error"),
    "least error in no norm": (monitor("least_error", u=X, norm="max"), "/monitor/norm", "'l2' or 'h1'"),
    "no weight": (monitor("least_error", u=X, distortion=0), "/monitor/distortion", "must be positive"),
    "other purpose": (small(monitor={"u": X, "for": "shells"}), "/monitor/for", "finite_volume"),
    "purpose of another kind": (monitor("curvature", u=X, **{"for": "finite_volume"}), "/monitor/for", "no such key"),
    "the key in Python": (small(monitor={"u": X, "purpose": "finite_volume"}), "/monitor/purpose", "no such key"),
    "no angle": (monitor("curvature", u=X, orthogonality=0), "/monitor/orthogonality", "over 0 and at most 90"),
    "text for rectilinear": (monitor("least_error", u=X, rectilinear="x"), "/monitor/rectilinear", "true or false"),
    "smooth least error": (monitor("least_error", u=X, smoothing=0.1), "/monitor/smoothing", "averages a metric"),
    "a tolerance of a descent": (
        {**monitor("least_error", u=X), "schwarz": {"tolerance": 1e-6}},
        "/schwarz/tolerance",
        "settings of equidistribution",
    ),
    "straight lines on subdomains": (
        {**monitor("least_error", u=X, rectilinear=True), "schwarz": {}},
        "/monitor/rectilinear",
        "run through all subdomains",
    ),
    "smooth auto": (small(monitor={"u": X, "smoothing": 0.1}), "/monitor/smoothing", "averages a metric"),
    "a of auto": (small(monitor={"u": X, "a": 0.5}), "/monitor/a", "add kind arc_length"),
    "auto inside": (both(ARC, {"kind": "auto", "u": X}), "/monitor/monitors/1/kind", "arc_length"),
    "bad text": (small(monitor={"u": "x+*y"}), "/monitor/u", "missing between", 3),
    "bad text inside": (both(ARC, {"kind": "weight", "rho": "y - 1"}), "/monitor/monitors/1/rho", "positive"),
    "curvature without u": (monitor("curvature"), "/monitor/u", "required"),
    "a of curvature": (monitor("curvature", u=X, a=1), "/monitor/a", "kind, u, norm, isotropic, smoothing"),
    "weight without rho": (monitor("weight", u=X), "/monitor/rho", "required"),
    "bad rho": (monitor("weight", rho={"expression": "x+*y"}), "/monitor/rho/expression", "", 3),
    "negative rho": (monitor("weight", rho={"expression": "x - 0.5"}), "/monitor/rho", "must be positive"),
    "number for rho": (
        monitor("weight", rho=3),
        "/monitor/rho",
        "expression, grid, nodal, scattered, block_nodes, samples",
    ),
    "tensor without m12": (monitor("tensor", m11=ONE, m22=ONE), "/monitor/m12", "required"),
    "indefinite tensor": (
        monitor("tensor", m11=ONE, m12={"expression": "2*x"}, m22=ONE),
        "/monitor/m12",
        "smallest eigenvalue",
    ),
    "samples of m11": (
        monitor("tensor", m11={"grid": {**GRID, "x": [0.2, 0.5, 1]}}, m12=X, m22=ONE),
        "/monitor/m11/grid/x",
        "cover",
    ),
    "one monitor": (both(ARC), "/monitor/monitors", "2 to 8"),
    "nine monitors": (both(*[ARC] * 9), "/monitor/monitors", "at most 8"),
    "no list of monitors": (monitor("intersection", monitors=ARC), "/monitor/monitors", "list"),
    "nested intersection": (both(ARC, both(ARC, ARC)["monitor"]), "/monitor/monitors/1/kind", "tensor"),
    "bad u inside": (both(ARC, {"u": {"expression": "1+foo"}}), "/monitor/monitors/1/u/expression", "foo", 3),
    "bad a inside": (both(ARC, {"u": X, "a": 2}), "/monitor/monitors/1/a", "[0, 1]"),
    "unknown map": (monitor("weight", rho=ONE, map="rows"), "/monitor/map", "'lines' or 'gradient'"),
    "gradient map inside": (both(ARC, {**WEIGHT, "map": "gradient"}), "/monitor/monitors/1/map", "leave out map"),
    "gradient map with subdomains": (
        {"monitor": {**WEIGHT, "map": "gradient"}, "schwarz": {}},
        "/schwarz",
        "not made of subdomains",
    ),
    "negative rho inside": (
        both(ARC, {"kind": "weight", "rho": {"expression": "y - 1"}}),
        "/monitor/monitors/1/rho",
        "positive",
    ),
    "unknown key inside": (both(ARC, {**WEIGHT, "a": 1}), "/monitor/monitors/1/a", "kind, rho, u, map, smoothing"),
    "unknown samples inside": (
        both({"u": {"samples": "s-nothing"}}, WEIGHT),
        "/monitor/monitors/0/u/samples",
        "no samples",
    ),
    "no upload inside": (both(WEIGHT, {"u": {"samples": "upload"}}), "/monitor/monitors/1/u/samples", "multipart"),
    "large smoothing": (
        small(monitor={"kind": "arc_length", "u": X, "smoothing": 0.3}),
        "/monitor/smoothing",
        "at most 0.25",
    ),
    "negative smoothing": (
        small(monitor={"kind": "arc_length", "u": X, "smoothing": -0.1}),
        "/monitor/smoothing",
        "positive",
    ),
    "large smoothing inside": (both(ARC, {**WEIGHT, "smoothing": 1}), "/monitor/monitors/1/smoothing", "0.25"),
    "negative b": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "b": -1}),
        "/monitor/b",
        "not negative",
    ),
    "large a": (small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": 1.5}), "/monitor/a", "[0, 1]"),
    "nan a": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": float("nan")}),
        "/monitor/a",
        "finite",
    ),
    "boolean a": (small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": True}), "/monitor/a", "number"),
}


@pytest.mark.parametrize("name", MONITORS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, MONITORS[name])
