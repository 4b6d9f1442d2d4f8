"""Bad sources of u: expressions, parameters, grids, scattered points, names of samples."""

from __future__ import annotations

import httpx
import numpy as np
import pytest

from service.conftest import small
from service.spec.bad_specs import (
    EXPRESSION,
    GRID,
    ONE,
    Refusal,
    expect_refusal,
    monitor,
    on_grid,
    scattered,
    u,
)

SOURCES: dict[str, Refusal] = {
    "syntax error": (u("x +* y"), EXPRESSION, "", 4),
    "open bracket": (u("sin(x"), EXPRESSION, ""),
    "empty": (u(""), EXPRESSION, ""),
    "unknown name": (u("x + foo"), EXPRESSION, "foo", 5),
    "unknown function": (u("x + spam(y)"), EXPRESSION, "spam", 5),
    "import": (u("__import__('os')"), EXPRESSION, "", 1),
    "attribute": (u("x.real"), EXPRESSION, ""),
    "tower of powers": (u("9**9**9**9"), EXPRESSION, ""),
    "lambda": (u("(lambda: x)()"), EXPRESSION, ""),
    "bit operation": (u("x & y"), EXPRESSION, ""),
    "pole inside": (u("1/(x - 0.5)"), EXPRESSION, "0.5", 1),
    "nan": (u("log(x - 2)"), EXPRESSION, "", 1),
    "infinite slope": (u("sqrt(x)"), EXPRESSION, "gradient", 1),
    "overflow": (u("exp(1000*x)"), EXPRESSION, "", 1),
    "very long": (u("+".join(["x"] * 10_000)), EXPRESSION, ""),
    "very deep": (u("(" * 5000 + "x" + ")" * 5000), EXPRESSION, ""),
    "nan parameter": (u("k*x", parameters={"k": float("nan")}), "/monitor/u/parameters/k", "finite"),
    "parameter named x": (u("x", parameters={"x": 1}), "/monitor/u/parameters/x", ""),
    "text parameter": (u("k*x", parameters={"k": "1"}), "/monitor/u/parameters/k", "number"),
    "one sample": (on_grid(x=[0], y=[0], values=[[1]]), "/monitor/u/grid/x", "at least 2"),
    "no samples": (on_grid(x=[], y=[], values=[]), "/monitor/u/grid/x", ""),
    "nan sample": (on_grid(values=[[0, 0], [1, float("nan")], [0, 2]]), "/monitor/u/grid/values/1/1", "finite"),
    "null sample": (on_grid(values=[[0, 0], [1, None], [0, 2]]), "/monitor/u/grid/values/1/1", "number"),
    "infinite axis": (on_grid(x=[0, 0.5, float("inf")]), "/monitor/u/grid/x/2", "finite"),
    "decreasing axis": (on_grid(x=[1, 0.5, 0]), "/monitor/u/grid/x", "decreases"),
    "repeated axis": (on_grid(x=[0, 0, 1]), "/monitor/u/grid/x", "repeats"),
    "wrong shape": (on_grid(values=[[0, 0], [1, 1]]), "/monitor/u/grid/values", ""),
    "ragged": (on_grid(values=[[0, 0], [1], [0, 2]]), "/monitor/u/grid/values", ""),
    "poor coverage": (on_grid(x=[0.2, 0.5, 1]), "/monitor/u/grid/x", "cover"),
    "one scattered": (scattered(points=[[0, 0]], values=[1]), "/monitor/u/scattered/points", ""),
    "scattered hole": (
        scattered(points=[[0, 0], [1, 0], [0, 1], [0.5, 0.2]], values=[1, 2, 3, 4]),
        "/monitor/u/scattered/points",
        "",
    ),
    "fewer values": (scattered(values=[1, 2]), "/monitor/u/scattered/values", ""),
    "triple": (scattered(points=[[0, 0, 0]]), "/monitor/u/scattered/points/0", ""),
    "unknown samples": (
        small(monitor={"kind": "arc_length", "u": {"samples": "s-nothing"}}),
        "/monitor/u/samples",
        "no samples",
    ),
    "no upload": (small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}), "/monitor/u/samples", "multipart"),
    "too many samples": (
        on_grid(x=list(np.linspace(0, 1, 5001)), values=[[0, 1]] * 5001),
        "/monitor/u/grid/values",
        "10000",
    ),
    "two sources": (
        small(monitor={"kind": "arc_length", "u": {"expression": "x", "grid": GRID}}),
        "/monitor/u/grid",
        "no such key",
    ),
    "no source": (small(monitor={"kind": "arc_length", "u": {}}), "/monitor/u", "expression"),
    "pole between points": (u("1/(x - 1/3)"), EXPRESSION, "grows without bound", 1),
    "sample too large": (on_grid(values=[[0, 0], [1, 1e200], [0, 2]]), "/monitor/u/grid/values", "rescale"),
    "bad u of a weight": (monitor("weight", rho=ONE, u={"expression": "foo"}), EXPRESSION, "foo", 1),
    "u beyond its domain": (
        small(monitor={"kind": "arc_length", "u": {"expression": "log(x)"}}, domain={"x": [-1, 1]}),
        EXPRESSION,
        "not finite",
        1,
    ),
    "samples of the unit square": (
        small(monitor={"kind": "arc_length", "u": {"grid": GRID}}, domain={"x": [0, 2]}),
        "/monitor/u/grid/x",
        "cover",
    ),
    "samples of another rectangle": (
        small(monitor={"kind": "arc_length", "u": {"grid": {**GRID, "x": [3 * x for x in GRID["x"]]}}}),
        "/monitor/u/grid/x",
        "give the domain that they cover, a rectangle with x=(0, 3)",
    ),
}


@pytest.mark.parametrize("name", SOURCES)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, SOURCES[name])
