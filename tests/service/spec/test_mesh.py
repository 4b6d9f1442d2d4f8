"""Bad input gets a precise answer: a 422 with pointer, message and position, and never a 500."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest

from service.conftest import PAPER, small

GRID = {"x": [0, 0.5, 1], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 2]]}
SCATTERED = {"points": [[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.6]], "values": [0, 1, 2, 3, 4]}


def u(expression: str, **more: Any) -> dict[str, Any]:
    return small(monitor={"u": {"expression": expression, **more}})


def on_grid(**more: Any) -> dict[str, Any]:
    return small(monitor={"u": {"grid": {**GRID, **more}}})


def scattered(**more: Any) -> dict[str, Any]:
    return small(monitor={"u": {"scattered": {**SCATTERED, **more}}})


def schwarz(**more: Any) -> dict[str, Any]:
    return small(schwarz=more)


def monitor(kind: str, **more: Any) -> dict[str, Any]:
    return small(monitor={"kind": kind, **more})


def both(*monitors: Any) -> dict[str, Any]:
    return monitor("intersection", monitors=list(monitors))


def on(**domain: Any) -> dict[str, Any]:
    return small(domain=domain)


def between(**sides: Any) -> dict[str, Any]:
    return small(domain={**CURVED, **sides})


X, ONE = {"expression": "x"}, {"expression": "1"}
ARC, WEIGHT = {"u": X}, {"kind": "weight", "rho": ONE}
CURVED: dict[str, Any] = {
    "kind": "quadrilateral",
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1.1, 0.5], [1, 1]]},
    "top": {"points": [[0, 1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}
LINE = [[0, k / 10_000] for k in range(10_001)]
EXPRESSION = "/monitor/u/expression"
# name: (spec, pointer, part of the message, column)
TABLE: dict[str, tuple[Any, str, str, int | None]] = {
    "syntax error": (u("x +* y"), EXPRESSION, "", 4),
    "open bracket": (u("sin(x"), EXPRESSION, "", None),
    "empty": (u(""), EXPRESSION, "", None),
    "unknown name": (u("x + foo"), EXPRESSION, "foo", 5),
    "unknown function": (u("x + spam(y)"), EXPRESSION, "spam", 5),
    "import": (u("__import__('os')"), EXPRESSION, "", 1),
    "attribute": (u("x.real"), EXPRESSION, "", None),
    "tower of powers": (u("9**9**9**9"), EXPRESSION, "", None),
    "lambda": (u("(lambda: x)()"), EXPRESSION, "", None),
    "bit operation": (u("x & y"), EXPRESSION, "", None),
    "pole inside": (u("1/(x - 0.5)"), EXPRESSION, "0.5", 1),
    "nan": (u("log(x - 2)"), EXPRESSION, "", 1),
    "infinite slope": (u("sqrt(x)"), EXPRESSION, "gradient", 1),
    "overflow": (u("exp(1000*x)"), EXPRESSION, "", 1),
    "very long": (u("+".join(["x"] * 20_000)), EXPRESSION, "", None),
    "very deep": (u("(" * 5000 + "x" + ")" * 5000), EXPRESSION, "", None),
    "nan parameter": (u("k*x", parameters={"k": float("nan")}), "/monitor/u/parameters/k", "finite", None),
    "parameter named x": (u("x", parameters={"x": 1}), "/monitor/u/parameters/x", "", None),
    "text parameter": (u("k*x", parameters={"k": "1"}), "/monitor/u/parameters/k", "number", None),
    "one sample": (on_grid(x=[0], y=[0], values=[[1]]), "/monitor/u/grid/x", "at least 2", None),
    "no samples": (on_grid(x=[], y=[], values=[]), "/monitor/u/grid/x", "", None),
    "nan sample": (on_grid(values=[[0, 0], [1, float("nan")], [0, 2]]), "/monitor/u/grid/values/1/1", "finite", None),
    "null sample": (on_grid(values=[[0, 0], [1, None], [0, 2]]), "/monitor/u/grid/values/1/1", "number", None),
    "infinite axis": (on_grid(x=[0, 0.5, float("inf")]), "/monitor/u/grid/x/2", "finite", None),
    "decreasing axis": (on_grid(x=[1, 0.5, 0]), "/monitor/u/grid/x", "decreases", None),
    "repeated axis": (on_grid(x=[0, 0, 1]), "/monitor/u/grid/x", "repeats", None),
    "wrong shape": (on_grid(values=[[0, 0], [1, 1]]), "/monitor/u/grid/values", "", None),
    "ragged": (on_grid(values=[[0, 0], [1], [0, 2]]), "/monitor/u/grid/values", "", None),
    "poor coverage": (on_grid(x=[0.2, 0.5, 1]), "/monitor/u/grid/x", "cover", None),
    "one scattered": (scattered(points=[[0, 0]], values=[1]), "/monitor/u/scattered/points", "", None),
    "scattered hole": (
        scattered(points=[[0, 0], [1, 0], [0, 1], [0.5, 0.2]], values=[1, 2, 3, 4]),
        "/monitor/u/scattered/points",
        "",
        None,
    ),
    "fewer values": (scattered(values=[1, 2]), "/monitor/u/scattered/values", "", None),
    "triple": (scattered(points=[[0, 0, 0]]), "/monitor/u/scattered/points/0", "", None),
    "unknown samples": (small(monitor={"u": {"samples": "s-nothing"}}), "/monitor/u/samples", "no samples", None),
    "no upload": (small(monitor={"u": {"samples": "upload"}}), "/monitor/u/samples", "multipart", None),
    "too many samples": (
        on_grid(x=list(np.linspace(0, 1, 5001)), values=[[0, 1]] * 5001),
        "/monitor/u/grid/values",
        "10000",
        None,
    ),
    "two sources": (small(monitor={"u": {"expression": "x", "grid": GRID}}), "/monitor/u/grid", "no such key", None),
    "no source": (small(monitor={"u": {}}), "/monitor/u", "expression", None),
    "no object": (small(grid=[8, 8]), "/grid", "must be a JSON object", None),
    "pole between points": (u("1/(x - 1/3)"), EXPRESSION, "grows without bound", 1),
    "sample too large": (on_grid(values=[[0, 0], [1, 1e200], [0, 2]]), "/monitor/u/grid/values", "rescale", None),
    "no monitor": ({}, "/monitor", "required", None),
    "null monitor": ({"monitor": None}, "/monitor", "", None),
    "other monitor": (small(monitor={"kind": "magic", "u": {"expression": "x"}}), "/monitor/kind", "arc_length", None),
    "other norm": (monitor("curvature", u=X, norm="l3"), "/monitor/norm", "'l2' or 'h1'", None),
    "text for isotropic": (monitor("curvature", u=X, isotropic="yes"), "/monitor/isotropic", "boolean", None),
    "curvature without u": (monitor("curvature"), "/monitor/u", "required", None),
    "a of curvature": (monitor("curvature", u=X, a=1), "/monitor/a", "kind, u, norm, isotropic, smoothing", None),
    "weight without rho": (monitor("weight", u=X), "/monitor/rho", "required", None),
    "bad rho": (monitor("weight", rho={"expression": "x+*y"}), "/monitor/rho/expression", "", 3),
    "negative rho": (monitor("weight", rho={"expression": "x - 0.5"}), "/monitor/rho", "must be positive", None),
    "number for rho": (monitor("weight", rho=3), "/monitor/rho", "expression, grid, scattered, samples", None),
    "bad u of a weight": (monitor("weight", rho=ONE, u={"expression": "foo"}), EXPRESSION, "foo", 1),
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
    "negative rho inside": (
        both(ARC, {"kind": "weight", "rho": {"expression": "y - 1"}}),
        "/monitor/monitors/1/rho",
        "positive",
        None,
    ),
    "unknown key inside": (both(ARC, {**WEIGHT, "a": 1}), "/monitor/monitors/1/a", "kind, rho, u, smoothing", None),
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
    "large smoothing": (small(monitor={"u": X, "smoothing": 0.3}), "/monitor/smoothing", "at most 0.25", None),
    "negative smoothing": (small(monitor={"u": X, "smoothing": -0.1}), "/monitor/smoothing", "positive", None),
    "large smoothing inside": (both(ARC, {**WEIGHT, "smoothing": 1}), "/monitor/monitors/1/smoothing", "0.25", None),
    "other domain": (on(kind="disk"), "/domain/kind", "rectangle, annulus_sector, quadrilateral", None),
    "text for a domain": (small(domain="rectangle"), "/domain", "must be an object", None),
    "empty rectangle": (on(kind="rectangle", x=[1, 1]), "/domain/x", "greater", None),
    "endless rectangle": (on(x=[0, float("inf")]), "/domain/x/1", "finite", None),
    "huge rectangle": (on(x=[0, 1e30]), "/domain/x", "1e+09", None),
    "radii of a rectangle": (on(radii=[1, 2]), "/domain/radii", "known are kind, x, y", None),
    "radii in disorder": (on(kind="annulus_sector", radii=[2, 1]), "/domain/radii", "less than", None),
    "whole disk": (on(kind="annulus_sector", radii=[0, 1]), "/domain/radii", "positive", None),
    "more than a turn": (on(kind="annulus_sector", angles=[0, 361]), "/domain/angles", "360", None),
    "three angles": (on(kind="annulus_sector", angles=[0, 1, 2]), "/domain/angles", "2 items", None),
    "three sides": (on(kind="quadrilateral", bottom={"x": "t", "y": "0"}), "/domain/right", "required", None),
    "no curve": (between(left=3), "/domain/left", "keys x, points", None),
    "half a curve": (between(left={"x": "0"}), "/domain/left/y", "required", None),
    "bad curve": (between(left={"x": "0", "y": "t +* 1"}), "/domain/left/y", "", 4),
    "curve in x": (between(left={"x": "x", "y": "t"}), "/domain/left/x", "x", 1),
    "infinite curve": (between(left={"x": "0", "y": "1/t"}), "/domain/left/y", "not finite", 1),
    "one point": (between(left={"points": [[0, 0]]}), "/domain/left/points", "2 give a straight line", None),
    "many points of a curve": (between(left={"points": LINE}), "/domain/left/points", "10000", None),
    "triples": (between(left={"points": [[0, 0, 0]]}), "/domain/left/points/0", "2 items", None),
    "open corner": (between(left={"points": [[0, 0], [0, 0.9]]}), "/domain/left", "must meet", None),
    "fold": (between(top={"points": [[0, 1], [0.5, -1], [1, 1]]}), "/domain", "", None),
    "u beyond its domain": (
        small(monitor={"u": {"expression": "log(x)"}}, domain={"x": [-1, 1]}),
        EXPRESSION,
        "not finite",
        1,
    ),
    "samples of the unit square": (
        small(monitor={"u": {"grid": GRID}}, domain={"x": [0, 2]}),
        "/monitor/u/grid/x",
        "cover",
        None,
    ),
    "samples of another rectangle": (
        small(monitor={"u": {"grid": {**GRID, "x": [3 * x for x in GRID["x"]]}}}),
        "/monitor/u/grid/x",
        "give the domain that they cover, a rectangle with x=(0, 3)",
        None,
    ),
    "other mode": (small(mode="fast"), "/mode", "'discretization' or 'tight'", None),
    "text for allow_relaxed": (small(allow_relaxed="no"), "/allow_relaxed", "boolean", None),
    "negative b": (small(monitor={"u": {"expression": "x"}, "b": -1}), "/monitor/b", "not negative", None),
    "large a": (small(monitor={"u": {"expression": "x"}, "a": 1.5}), "/monitor/a", "[0, 1]", None),
    "nan a": (small(monitor={"u": {"expression": "x"}, "a": float("nan")}), "/monitor/a", "finite", None),
    "boolean a": (small(monitor={"u": {"expression": "x"}, "a": True}), "/monitor/a", "number", None),
    "few points": (small(grid={"n_xi": 3, "n_eta": 8}), "/grid/n_xi", "at least 4", None),
    "negative points": (small(grid={"n_xi": -8, "n_eta": -8}), "/grid/n_xi", "at least 4", None),
    "fractional points": (small(grid={"n_xi": 8.5, "n_eta": 8}), "/grid/n_xi", "integer", None),
    "text points": (small(grid={"n_xi": "8"}), "/grid/n_xi", "integer", None),
    "many points": (small(grid={"n_xi": 200, "n_eta": 200}), "/grid", "20000", None),
    "absurd points": (small(grid={"n_xi": 10**30, "n_eta": 8}), "/grid/n_xi", "20000", None),
    "endless points": (
        '{"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": ' + "9" * 9999 + "}}",
        "/grid/n_xi",
        "",
        None,
    ),
    "large overlap": (schwarz(overlap=8), "/schwarz/overlap", "wider than the overlap", None),
    "absurd overlap": (schwarz(overlap=10**12), "/schwarz/overlap", "larger than the grid", None),
    "small overlap": (schwarz(overlap=1), "/schwarz/overlap", "at least 2", None),
    "many subdomains": (schwarz(subdomains=[9, 1], overlap=2), "/schwarz/subdomains", "do not fit", None),
    "absurd subdomains": (schwarz(subdomains=[10**12, 1]), "/schwarz/subdomains", "16", None),
    "no subdomain": (schwarz(subdomains=[0, 1]), "/schwarz/subdomains", "at least 1", None),
    "three directions": (schwarz(subdomains=[2, 1, 1]), "/schwarz/subdomains", "2 items", None),
    "negative p": (
        schwarz(transmission={"kind": "linear_robin", "p": -2}),
        "/schwarz/transmission/p",
        "positive",
        None,
    ),
    "word for p": (
        schwarz(transmission={"kind": "linear_robin", "p": "big"}),
        "/schwarz/transmission/p",
        "this must be a positive number, or 'auto'",
        None,
    ),
    "p of optimized": (
        schwarz(transmission={"kind": "optimized", "p": 1}),
        "/schwarz/transmission/p",
        "no such key here; known are kind, data",
        None,
    ),
    "other data": (
        schwarz(transmission={"kind": "optimized", "data": "all"}),
        "/schwarz/transmission/data",
        "'line_sums' or 'local'",
        None,
    ),
    "other line correction": (schwarz(line_correction="some"), "/schwarz/line_correction", "0 to 10, or 'auto'", None),
    "many line corrections": (schwarz(line_correction=11), "/schwarz/line_correction", "0 to 10", None),
    "fractional line corrections": (schwarz(line_correction=1.5), "/schwarz/line_correction", "whole number", None),
    "other acceleration": (schwarz(acceleration="aitken"), "/schwarz/acceleration", "'anderson'", None),
    "other local solver": (schwarz(local_solver="direct"), "/schwarz/local_solver", "'sweeps' or 'newton'", None),
    "fallback as text": (schwarz(fallback="no"), "/schwarz/fallback", "boolean", None),
    "word for tolerance": (schwarz(tolerance="low"), "/schwarz/tolerance", "'discretization', or null", None),
    "p of classical": (
        schwarz(transmission={"kind": "classical", "p": 1}),
        "/schwarz/transmission/p",
        "no such key",
        None,
    ),
    "other transmission": (schwarz(transmission={"kind": "magic"}), "/schwarz/transmission/kind", "classical", None),
    "transmission as text": (schwarz(transmission="classical"), "/schwarz/transmission", "kind", None),
    "zero tolerance": (schwarz(tolerance=0), "/schwarz/tolerance", "positive", None),
    "no iteration": (schwarz(max_iterations=0), "/schwarz/max_iterations", "at least 1", None),
    "absurd iterations": (schwarz(max_iterations=10**9), "/schwarz/max_iterations", "at most", None),
    "other ordering": (schwarz(ordering="random"), "/schwarz/ordering", "'coloured'", None),
    "other boundary": (small(boundary="free"), "/boundary", "trace", None),
    "other initial": (small(initial="cold"), "/initial", "nested", None),
    "other cells": (small(cells="hex"), "/cells", "triangle", None),
    "long label": (small(label="x" * 201), "/label", "200", None),
    "half a character": ('{"monitor": {"u": {"expression": "x"}}, "label": "\\ud800"}', "/label", "surrogate", None),
    "a text that no database takes": (
        '{"monitor": {"u": {"expression": "x"}}, "label": "a\\u0000b"}',
        "/label",
        "this text must not hold the character U+0000",
        None,
    ),
    "half a key": ('{"monitor": {"u": {"expression": "x"}}, "\\udfff": 1}', "", "surrogate", None),
    "unknown key": (small(labell="x"), "/labell", "known are", None),
    "unknown inner key": (small(grid={"n_x": 8}), "/grid/n_x", "n_xi, n_eta", None),
    "pointer escapes": (small(**{"a/b~c": 1}), "/a~1b~0c", "no such key", None),
    "a list": ([], "", "object", None),
    "a number": ("3", "", "object", None),
    "null": ("null", "", "object", None),
}


@pytest.mark.parametrize("name", TABLE)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    spec, pointer, message, column = TABLE[name]
    body = spec if isinstance(spec, str) else json.dumps(spec)
    answer = http.post("/v1/meshes", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert (problem["type"], problem["status"]) == ("/problems/invalid-input", 422)
    first = problem["errors"][0]
    assert first["pointer"] == pointer, first
    assert message in first["message"], first
    assert len(first["message"]) < 1000
    if column is not None:
        assert first["position"]["column"] == column, first


@pytest.mark.parametrize("constant", ["1", "0*x", "3 + t"])
def test_a_constant_u_gives_the_uniform_mesh(http: httpx.Client, constant: str) -> None:
    answer = http.post("/v1/meshes?format=npz", json=u(constant), headers={"Prefer": "wait=30"})
    assert answer.status_code == 201
    arrays = np.load(io.BytesIO(answer.content))
    np.testing.assert_allclose(arrays["x"], np.linspace(0, 1, 8)[:, None] * np.ones(9), atol=1e-14)


MALFORMED: dict[str, bytes] = {
    "nothing": b"",
    "half an object": b'{"monitor": ',
    "not UTF-8": b'{"label": "\xff"}',
    "UTF-16": '{"monitor": 1}'.encode("utf-16"),
    "twice a key": b'{"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 8, "n_xi": 9}}',
    "deep lists": b"[" * 200_000,
    "deep objects": b'{"a":' * 100_000,
    "text": b"hello",
    "a comment": b"{} // no",
}


@pytest.mark.parametrize("name", MALFORMED)
def test_what_is_not_json_is_a_400(http: httpx.Client, name: str) -> None:
    answer = http.post("/v1/meshes", content=MALFORMED[name], headers={"Content-Type": "application/json"})
    assert answer.status_code == 400, answer.text
    assert answer.json()["type"] == "/problems/malformed-body"


def test_all_complaints_come_at_once(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", json={"monitor": {"u": {"expression": "x"}, "a": "1"}, "cells": "hex", "n": 1})
    assert [entry["pointer"] for entry in answer.json()["errors"]] == ["/monitor/a", "/cells", "/n"]


def test_the_type_of_the_body_counts(http: httpx.Client) -> None:
    for headers in (
        {"Content-Type": "text/plain"},
        {},
        {"Content-Type": "application/json", "Content-Encoding": "gzip"},
    ):
        answer = http.post("/v1/meshes", content=b"{}", headers=headers)
        assert answer.status_code == 415
        assert answer.json()["type"] == "/problems/unsupported-media-type"


def test_large_bodies_are_refused_before_they_are_read(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    announced = http.post("/v1/meshes", content=b" " * 2_000_001, headers=headers)
    streamed = http.post("/v1/meshes", content=(b" " * 100_000 for _ in range(30)), headers=headers)
    for answer in (announced, streamed):
        assert answer.status_code == 413
        assert answer.json()["type"] == "/problems/body-too-large"


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=1000", "limit=x", "status=done", "cursor=zzz", f"cursor={'f' * 40}"]
)
def test_bad_queries_name_the_parameter(http: httpx.Client, query: str) -> None:
    answer = http.get(f"/v1/meshes?{query}")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == query.partition("=")[0]


@pytest.mark.parametrize("key", ["", "k" * 256])
def test_bad_keys_are_refused(http: httpx.Client, key: str) -> None:
    answer = http.post("/v1/meshes", json=small(), headers={"Idempotency-Key": key})
    assert answer.status_code == 400
    assert answer.json()["type"] == "/problems/malformed-header"


@pytest.mark.parametrize(
    "prefer", ["wait", "wait=", "wait=-1", "wait=x", "respond-async", "wait=99999999999999", ",,;="]
)
def test_preferences_that_cannot_be_read_are_ignored(http: httpx.Client, prefer: str) -> None:
    answer = http.post("/v1/meshes", json=small(), headers={"Prefer": prefer})
    assert answer.status_code in (201, 202)
    assert "preference-applied" not in answer.headers


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="other"\r\n\r\n{}\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="samples"; filename="a.npz"\r\n\r\n{}\r\n--b--\r\n',
        b"--b\r\nContent-Disposition: form-data\r\n\r\n{}\r\n--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}',
        (b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}\r\n' * 2) + b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n\xff\xfe\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n' + b"\r\n" * 50_000 + b"--b--\r\n",
    ],
)
def test_broken_multipart_is_a_400(http: httpx.Client, body: bytes) -> None:
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    answer = http.post("/v1/meshes", content=body, headers=headers)
    assert answer.status_code == 400, answer.text
    assert http.post("/v1/meshes", content=body, headers={"Content-Type": "multipart/form-data"}).status_code == 400


UPLOADS: dict[str, tuple[str, bytes]] = {
    "empty": ("a.npz", b""),
    "not a zip": ("a.npz", b"PK\x03\x04 no"),
    "no suffix": ("samples", b"1,2,3"),
    "executable": ("a.exe", b"MZ"),
    "pickle": ("a.npy", b"\x80\x04\x95K\x01."),
    "text in csv": ("a.csv", b"x,y,u\n0,0,zero\n"),
    "nan in csv": ("a.csv", b"x,y,u\n0,0,nan\n0,1,1\n1,0,1\n1,1,1\n"),
    "not xml": ("a.vtu", b"<VTKFile"),
    "entity bomb": ("a.vtu", b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa">]><VTKFile>&a;</VTKFile>'),
    "broken vtk": ("a.vtk", b"# vtk DataFile Version 4.2\n"),
    "json list": ("a.json", b"[1, 2]"),
}


@pytest.mark.parametrize("name", UPLOADS)
def test_bad_uploads_are_refused(http: httpx.Client, name: str) -> None:
    filename, data = UPLOADS[name]
    answer = http.post("/v1/samples", files={"samples": (filename, data)})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["message"]
    spec = json.dumps(small(monitor={"u": {"samples": "upload"}}))
    answer = http.post("/v1/meshes", files={"spec": (None, spec), "samples": (filename, data)})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["pointer"].startswith("/monitor/u/samples")


def test_an_upload_that_the_spec_does_not_use_is_refused(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", files={"spec": (None, json.dumps(small())), "samples": ("a.csv", b"x,y,u\n")})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/monitor/u"


def test_expression_check_tells_the_column(http: httpx.Client) -> None:
    good = http.post("/v1/expressions/check", json={"expression": PAPER})
    assert good.status_code == 200
    report = good.json()
    assert (report["names"], report["constant"]) == (["x", "y"], False)
    assert report["u"]["max"] == pytest.approx(1.0, abs=0.01)
    assert report["gradient"]["max"] == pytest.approx(15.0, abs=0.01)
    bad = http.post("/v1/expressions/check", json={"expression": "x + foo"})
    assert bad.status_code == 422
    assert bad.json()["errors"] == [
        {
            "pointer": "/expression",
            "message": bad.json()["errors"][0]["message"],
            "position": {"offset": 4, "line": 1, "column": 5},
        }
    ]
    assert http.post("/v1/expressions/check", content=b"x").status_code == 415
    assert http.post("/v1/expressions/check", json={"expression": 1}).status_code == 422
