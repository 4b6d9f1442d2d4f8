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
    "no monitor": ({}, "/monitor", "required", None),
    "null monitor": ({"monitor": None}, "/monitor", "", None),
    "other monitor": (small(monitor={"kind": "magic", "u": {"expression": "x"}}), "/monitor/kind", "arc_length", None),
    "other norm": (monitor("curvature", u=X, norm="l3"), "/monitor/norm", "'l2' or 'h1'", None),
    "text for isotropic": (monitor("curvature", u=X, isotropic="yes"), "/monitor/isotropic", "true or false", None),
    "least error without u": (monitor("least_error", norm="h1"), "/monitor/u", "the norm is that of the error", None),
    "least error in no norm": (monitor("least_error", u=X, norm="max"), "/monitor/norm", "'l2' or 'h1'", None),
    "no weight": (monitor("least_error", u=X, distortion=0), "/monitor/distortion", "must be positive", None),
    "other purpose": (small(monitor={"u": X, "for": "shells"}), "/monitor/for", "finite_volume", None),
    "purpose of another kind": (
        monitor("curvature", u=X, **{"for": "finite_volume"}),
        "/monitor/for",
        "no such key",
        None,
    ),
    "the key in Python": (small(monitor={"u": X, "purpose": "finite_volume"}), "/monitor/purpose", "no such key", None),
    "no angle": (monitor("curvature", u=X, orthogonality=0), "/monitor/orthogonality", "over 0 and at most 90", None),
    "text for rectilinear": (
        monitor("least_error", u=X, rectilinear="x"),
        "/monitor/rectilinear",
        "true or false",
        None,
    ),
    "smooth least error": (monitor("least_error", u=X, smoothing=0.1), "/monitor/smoothing", "averages a metric", None),
    "least error on subdomains": (
        {**monitor("least_error", u=X), "schwarz": {}},
        "/schwarz",
        "minimises one integral over all cells",
        None,
    ),
    "smooth auto": (small(monitor={"u": X, "smoothing": 0.1}), "/monitor/smoothing", "averages a metric", None),
    "a of auto": (small(monitor={"u": X, "a": 0.5}), "/monitor/a", "add kind arc_length", None),
    "auto inside": (both(ARC, {"kind": "auto", "u": X}), "/monitor/monitors/1/kind", "arc_length", None),
    "bad text": (small(monitor={"u": "x+*y"}), "/monitor/u", "missing between", 3),
    "bad text inside": (both(ARC, {"kind": "weight", "rho": "y - 1"}), "/monitor/monitors/1/rho", "positive", None),
    "curvature without u": (monitor("curvature"), "/monitor/u", "required", None),
    "a of curvature": (monitor("curvature", u=X, a=1), "/monitor/a", "kind, u, norm, isotropic, smoothing", None),
    "weight without rho": (monitor("weight", u=X), "/monitor/rho", "required", None),
    "bad rho": (monitor("weight", rho={"expression": "x+*y"}), "/monitor/rho/expression", "", 3),
    "negative rho": (monitor("weight", rho={"expression": "x - 0.5"}), "/monitor/rho", "must be positive", None),
    "number for rho": (
        monitor("weight", rho=3),
        "/monitor/rho",
        "expression, grid, nodal, scattered, block_nodes, samples",
        None,
    ),
    "tensor without m12": (monitor("tensor", m11=ONE, m22=ONE), "/monitor/m12", "required", None),
    "indefinite tensor": (
        monitor("tensor", m11=ONE, m12={"expression": "2*x"}, m22=ONE),
        "/monitor/m12",
        "smallest eigenvalue",
        None,
    ),
    "samples of m11": (
        monitor("tensor", m11={"grid": {**GRID, "x": [0.2, 0.5, 1]}}, m12=X, m22=ONE),
        "/monitor/m11/grid/x",
        "cover",
        None,
    ),
    "one monitor": (both(ARC), "/monitor/monitors", "2 to 8", None),
    "nine monitors": (both(*[ARC] * 9), "/monitor/monitors", "at most 8", None),
    "no list of monitors": (monitor("intersection", monitors=ARC), "/monitor/monitors", "list", None),
    "nested intersection": (both(ARC, both(ARC, ARC)["monitor"]), "/monitor/monitors/1/kind", "tensor", None),
    "bad u inside": (both(ARC, {"u": {"expression": "1+foo"}}), "/monitor/monitors/1/u/expression", "foo", 3),
    "bad a inside": (both(ARC, {"u": X, "a": 2}), "/monitor/monitors/1/a", "[0, 1]", None),
    "unknown map": (monitor("weight", rho=ONE, map="rows"), "/monitor/map", "'lines' or 'gradient'", None),
    "gradient map inside": (both(ARC, {**WEIGHT, "map": "gradient"}), "/monitor/monitors/1/map", "leave out map", None),
    "gradient map with subdomains": (
        {"monitor": {**WEIGHT, "map": "gradient"}, "schwarz": {}},
        "/schwarz",
        "not made of subdomains",
        None,
    ),
    "negative rho inside": (
        both(ARC, {"kind": "weight", "rho": {"expression": "y - 1"}}),
        "/monitor/monitors/1/rho",
        "positive",
        None,
    ),
    "unknown key inside": (
        both(ARC, {**WEIGHT, "a": 1}),
        "/monitor/monitors/1/a",
        "kind, rho, u, map, smoothing",
        None,
    ),
    "unknown samples inside": (
        both({"u": {"samples": "s-nothing"}}, WEIGHT),
        "/monitor/monitors/0/u/samples",
        "no samples",
        None,
    ),
    "no upload inside": (
        both(WEIGHT, {"u": {"samples": "upload"}}),
        "/monitor/monitors/1/u/samples",
        "multipart",
        None,
    ),
    "large smoothing": (
        small(monitor={"kind": "arc_length", "u": X, "smoothing": 0.3}),
        "/monitor/smoothing",
        "at most 0.25",
        None,
    ),
    "negative smoothing": (
        small(monitor={"kind": "arc_length", "u": X, "smoothing": -0.1}),
        "/monitor/smoothing",
        "positive",
        None,
    ),
    "large smoothing inside": (both(ARC, {**WEIGHT, "smoothing": 1}), "/monitor/monitors/1/smoothing", "0.25", None),
    "negative b": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "b": -1}),
        "/monitor/b",
        "not negative",
        None,
    ),
    "large a": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": 1.5}),
        "/monitor/a",
        "[0, 1]",
        None,
    ),
    "nan a": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": float("nan")}),
        "/monitor/a",
        "finite",
        None,
    ),
    "boolean a": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": True}),
        "/monitor/a",
        "number",
        None,
    ),
}


@pytest.mark.parametrize("name", MONITORS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, MONITORS[name])
