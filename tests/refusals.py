"""Documents with one mistake each, and where it is: what the service refuses, and the solver without it, too."""

from __future__ import annotations

from typing import Any

import numpy as np

import equimesh as em
from service.conftest import small
from service.requests import CURVED, STEP

# The document; the pointer to the mistake; a part of the sentence of the service; and in an expression the column.
Refusal = tuple[Any, str, str] | tuple[Any, str, str, int]


GRID = {"x": [0, 0.5, 1], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 2]]}
SCATTERED = {"points": [[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.6]], "values": [0, 1, 2, 3, 4]}


def u(expression: str, **more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"expression": expression, **more}})


def on_grid(**more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"grid": {**GRID, **more}}})


def scattered(**more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"scattered": {**SCATTERED, **more}}})


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


X = {"expression": "x"}
ONE = {"expression": "1"}
ARC: dict[str, Any] = {"u": X}
WEIGHT = {"kind": "weight", "rho": ONE}
LINE = [[0, k / 10_000] for k in range(10_001)]
EXPRESSION = "/monitor/u/expression"
AIMED = {"monitor": {"u": "tanh(9*(x - y))"}}
AT = [k / 4 for k in range(5)]
NODAL: dict[str, Any] = {"nodal": {"x": [[at] * 5 for at in AT], "y": [AT] * 5, "values": [AT] * 5}}
BENT: dict[str, Any] = {"nodal": {**NODAL["nodal"], "y": [[at**2 for at in AT]] * 5}}
ZERO: dict[str, Any] = {"nodal": {**NODAL["nodal"], "values": [[0] * 5] * 5}}
FIVE = {"n_xi": 5, "n_eta": 5}
LEAST: dict[str, Any] = {"kind": "least_error", "u": {"expression": "tanh(9*(y - x))"}}


def on_step(**more: Any) -> dict[str, Any]:
    return {"monitor": LEAST, "domain": STEP, **more}


def other_step(**more: Any) -> dict[str, Any]:
    return on_step(domain={**STEP, **more})


NODES = em.Blocks.of(STEP).mesh.points.tolist()
AT_NODES = {"nodes": NODES, "values": [x * y for x, y in NODES]}
ON_STEP = {"block_nodes": AT_NODES}
UNEVEN = [{**STEP["blocks"][0], "cells": [6, 5]}, *STEP["blocks"][1:]]

# By the part of the document with the mistake.
REFUSALS: dict[str, dict[str, Refusal]] = {
    "document": {
        "no object": (small(grid=[8, 8]), "/grid", 'must be a JSON object, such as {"n_xi": 33, "n_eta": 33}'),
        "samples in place of their id": (
            small(monitor={"kind": "arc_length", "u": {"samples": {"grid": GRID}}}),
            "/monitor/u/samples",
            "as grid, nodal, scattered or block_nodes",
        ),
        "unknown key": (small(labell="x"), "/labell", "known are"),
        "unknown inner key": (small(grid={"n_x": 8}), "/grid/n_x", "n_xi, n_eta"),
    },
    "mesh": {
        "other mode": (small(mode="fast"), "/mode", "'discretization' or 'tight'"),
        "text for allow_relaxed": (small(allow_relaxed="no"), "/allow_relaxed", "true or false"),
        "few points": (small(grid={"n_xi": 3, "n_eta": 8}), "/grid/n_xi", "at least 4"),
        "negative points": (small(grid={"n_xi": -8, "n_eta": -8}), "/grid/n_xi", "at least 4"),
        "fractional points": (small(grid={"n_xi": 8.5, "n_eta": 8}), "/grid/n_xi", "whole number"),
        "text points": (small(grid={"n_xi": "8"}), "/grid/n_xi", "whole number"),
        "other boundary": (small(boundary="free"), "/boundary", "trace"),
        "other initial": (small(initial="cold"), "/initial", "nested"),
        "other cells": (small(cells="hex"), "/cells", "triangle"),
        "unknown monitor": (small(monitr={}), "/monitr", "did you mean"),
        "null domain": (small(domain=None), "/domain", ""),
        "null initial": (small(initial=None), "/initial", "nested"),
        "number for a label": (small(label=3), "/label", ""),
    },
    "target": {
        "both": (
            {**AIMED, "grid": {"n_xi": 9, "n_eta": 9}, "target": {"error": 1}},
            "/target",
            "takes the place of the grid",
        ),
        "no error": ({**AIMED, "target": {}}, "/target/error", "required"),
        "error of zero": ({**AIMED, "target": {"error": 0}}, "/target/error", "positive"),
        "other norm": ({**AIMED, "target": {"error": 1, "norm": "max"}}, "/target/norm", "'l2' or 'h1'"),
        "few points": ({**AIMED, "target": {"error": 1, "max_points": 9}}, "/target/max_points", "at least 25"),
        "no function": ({"monitor": {"kind": "weight", "rho": "1"}, "target": {"error": 1}}, "/target", "has no u"),
        "few points of a shape": ({**AIMED, "grid": {"points": 24}}, "/grid/points", "at least 25 points"),
        "points and n_xi": ({**AIMED, "grid": {"points": 99, "n_xi": 9}}, "/grid/points", "give one of them"),
        "points and an error": (
            {**AIMED, "grid": {"points": 99}, "target": {"error": 1}},
            "/target",
            "takes the place of the grid",
        ),
        "subdomains": ({**AIMED, "schwarz": {}, "target": {"error": 1}}, "/target", "a grid that is known"),
    },
    "source": {
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
        "no upload": (
            small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}),
            "/monitor/u/samples",
            "multipart",
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
        "number for an expression": (u(3), EXPRESSION, ""),
        "list of parameters": (u("x", parameters=[]), "/monitor/u/parameters", ""),
        "endless t": (u("x + t", t=float("inf")), "/monitor/u/t", "finite"),
        "grid without y": (
            small(monitor={"kind": "arc_length", "u": {"grid": {"x": [0, 1]}}}),
            "/monitor/u/grid/y",
            "",
        ),
        "unknown key of a grid": (on_grid(u=1), "/monitor/u/grid/u", "no such key"),
        "number for samples": (small(monitor={"kind": "arc_length", "u": {"samples": 3}}), "/monitor/u/samples", ""),
    },
    "monitor": {
        "no monitor": ({}, "/monitor", "required"),
        "null monitor": ({"monitor": None}, "/monitor", ""),
        "other monitor": (small(monitor={"kind": "magic", "u": {"expression": "x"}}), "/monitor/kind", "arc_length"),
        "other norm": (monitor("curvature", u=X, norm="l3"), "/monitor/norm", "'l2' or 'h1'"),
        "text for isotropic": (monitor("curvature", u=X, isotropic="yes"), "/monitor/isotropic", "true or false"),
        "least error without u": (monitor("least_error", norm="h1"), "/monitor/u", "the norm is that of the error"),
        "least error in no norm": (monitor("least_error", u=X, norm="max"), "/monitor/norm", "'l2' or 'h1'"),
        "no weight": (monitor("least_error", u=X, distortion=0), "/monitor/distortion", "must be positive"),
        "other purpose": (small(monitor={"u": X, "for": "shells"}), "/monitor/for", "finite_volume"),
        "purpose of another kind": (
            monitor("curvature", u=X, **{"for": "finite_volume"}),
            "/monitor/for",
            "no such key",
        ),
        "the key in Python": (small(monitor={"u": X, "purpose": "finite_volume"}), "/monitor/purpose", "no such key"),
        "no angle": (monitor("curvature", u=X, orthogonality=0), "/monitor/orthogonality", "over 0 and at most 90"),
        "text for rectilinear": (monitor("least_error", u=X, rectilinear="x"), "/monitor/rectilinear", "true or false"),
        "no degree": (monitor("least_error", u=X, degree=5), "/monitor/degree", "a whole number from 1 to 4"),
        "half a degree": (monitor("least_error", u=X, degree=1.5), "/monitor/degree", "whole number"),
        "degree 3 on triangles": (
            {**monitor("least_error", u=X, degree=3), "cells": "triangle"},
            "/monitor/degree",
            "on triangles elements have degree 1 or 2",
        ),
        "degree of a metric": (monitor("curvature", u=X, degree=2), "/monitor/degree", "a metric knows no elements"),
        "degree of both": (
            small(monitor={**both(ARC, ARC)["monitor"], "degree": 2}),
            "/monitor/degree",
            "a metric knows no elements",
        ),
        "adjoint of another mesh": (
            {**monitor("nodal_solution", u=NODAL, adjoint=BENT), "grid": {"n_xi": 5, "n_eta": 5}},
            "/monitor/adjoint",
            "the adjoint belongs to another mesh than u",
        ),
        "adjoint of a constant": (
            {**monitor("nodal_solution", u=NODAL, adjoint=ZERO), "grid": {"n_xi": 5, "n_eta": 5}},
            "/monitor/adjoint",
            "the functional is constant",
        ),
        "adjoint of degree 2": (
            monitor("nodal_solution", u=NODAL, adjoint=NODAL, degree=2),
            "/monitor/degree",
            "on elements of degree 1 alone",
        ),
        "adjoint of a metric": (
            monitor("curvature", u=X, adjoint=X),
            "/monitor/adjoint",
            "a metric knows no functional",
        ),
        **{
            f"{name} of a round": ({**monitor("nodal_solution", u=NODAL), **more}, pointer, words)
            for name, more, pointer, words in (
                ("boundary", {"grid": FIVE, "boundary": "orthogonal"}, "/boundary", "slide for the least error"),
                ("start", {"grid": FIVE, "initial": "uniform"}, "/initial", "leave initial out"),
                ("start for points", {"grid": {"points": 25}, "initial": "uniform"}, "/initial", "leave initial out"),
                ("norm", {"grid": None, "target": {"norm": "h1", "max_points": 25}}, "/target/norm", "norm of the mon"),
            )
        },
        "degree inside": (both(ARC, {"u": X, "degree": 2}), "/monitor/monitors/1/degree", "a metric knows no elements"),
        "degree of finite volumes": (
            small(monitor={"u": X, "for": "finite_volume", "degree": 2}),
            "/monitor/degree",
            "compares solvers of lower degree",
        ),
        "degree on subdomains": (
            {**small(monitor={"u": X, "degree": 2}), "schwarz": {}},
            "/monitor/degree",
            "equidistribute a metric",
        ),
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
        "boolean a": (
            small(monitor={"kind": "arc_length", "u": {"expression": "x"}, "a": True}),
            "/monitor/a",
            "number",
        ),
        "rho of auto": (small(monitor={"u": X, "rho": ONE}), "/monitor/rho", "no such key"),
        "negative smoothness": (monitor("least_error", u=X, smoothness=-1), "/monitor/smoothness", ""),
        "text for smoothness": (monitor("least_error", u=X, smoothness="1"), "/monitor/smoothness", "number"),
        "list for a norm": (monitor("curvature", u=X, norm=["l2"]), "/monitor/norm", "'l2' or 'h1'"),
        "number for isotropic": (monitor("curvature", u=X, isotropic=1), "/monitor/isotropic", "true or false"),
        "text for a": (monitor("arc_length", u=X, a="1"), "/monitor/a", "number"),
    },
    "domain": {
        "other domain": (on(kind="disk"), "/domain/kind", "rectangle, annulus_sector, quadrilateral"),
        "text for a domain": (small(domain="rectangle"), "/domain", "must be an object"),
        "empty rectangle": (on(kind="rectangle", x=[1, 1]), "/domain/x", "greater"),
        "endless rectangle": (on(x=[0, float("inf")]), "/domain/x/1", "finite"),
        "huge rectangle": (on(x=[0, 1e30]), "/domain/x", "1e+09"),
        "radii of a rectangle": (on(radii=[1, 2]), "/domain/radii", "known are kind, x, y"),
        "radii in disorder": (on(kind="annulus_sector", radii=[2, 1]), "/domain/radii", "less than"),
        "open ring": (on(kind="annulus_sector", closed=True, angles=[0, 180]), "/domain/closed", "span 180 degrees"),
        "no direction": (on(periodic="z"), "/domain/periodic", "'x', 'y' or 'both'"),
        "no seam": (between(closed=True), "/domain/closed", "no two opposite sides are one curve"),
        "no flag": (on(kind="annulus_sector", closed=1), "/domain/closed", "true or false"),
        "u that does not repeat itself": (on(periodic="x"), "/domain/periodic", "take a u that repeats itself"),
        "whole disk": (on(kind="annulus_sector", radii=[0, 1]), "/domain/radii", "positive"),
        "more than a turn": (on(kind="annulus_sector", angles=[0, 361]), "/domain/angles", "360"),
        "three angles": (on(kind="annulus_sector", angles=[0, 1, 2]), "/domain/angles", "2 items"),
        "three sides": (on(kind="quadrilateral", bottom={"x": "t", "y": "0"}), "/domain/right", "required"),
        "no curve": (between(left=3), "/domain/left", "keys x, points"),
        "half a curve": (between(left={"x": "0"}), "/domain/left/y", "required"),
        "bad curve": (between(left={"x": "0", "y": "t +* 1"}), "/domain/left/y", "", 4),
        "curve in x": (between(left={"x": "x", "y": "t"}), "/domain/left/x", "x", 1),
        "infinite curve": (between(left={"x": "0", "y": "1/t"}), "/domain/left/y", "not finite", 1),
        "one point": (between(left={"points": [[0, 0]]}), "/domain/left/points", "2 give a straight line"),
        "many points of a curve": (between(left={"points": LINE}), "/domain/left/points", "10000"),
        "triples": (between(left={"points": [[0, 0, 0]]}), "/domain/left/points/0", "2 items"),
        "open corner": (between(left={"points": [[0, 0], [0, 0.9]]}), "/domain/left", "must meet"),
        "fold": (between(top={"points": [[0, 1], [0.5, -1], [1, 1]]}), "/domain", ""),
        "text for radii": (on(kind="annulus_sector", radii="12"), "/domain/radii", ""),
        "number for a formula": (between(left={"x": "0", "y": 3}), "/domain/left/y", ""),
    },
    "blocks": {
        "grid": (on_step(grid={"n_xi": 9, "n_eta": 9}), "/grid", "leave the grid out"),
        "another schwarz": (on_step(schwarz={"subdomains": [2, 2]}), "/schwarz/subdomains", "this domain has blocks"),
        "schwarz.overlap": (on_step(schwarz={"overlap": 0}), "/schwarz/overlap", "from 1 to 64"),
        "schwarz.max_exchanges": (on_step(schwarz={"max_exchanges": 1001}), "/schwarz/max_exchanges", "at most 1000"),
        "schwarz.groups": (on_step(schwarz={"groups": [["upper"]]}), "/schwarz/groups", "is in no group"),
        "no list of groups": (on_step(schwarz={"groups": ["upper"]}), "/schwarz/groups", "a list of lists"),
        "few points": (on_step(grid={"points": 30}), "/grid/points", "the coarsest mesh of these blocks has 65 points"),
        "points and n_xi": (on_step(grid={"points": 99, "n_xi": 9}), "/grid/points", "give one of them"),
        "points and groups": (on_step(grid={"points": 99}, schwarz={}), "/grid/points", "give no number of points"),
        "error of a round": (
            on_step(target={"error": 1}, monitor={"kind": "nodal_solution", "u": ON_STEP}),
            "/target/error",
            "give max_points alone",
        ),
        "start of a round": (
            on_step(initial="uniform", monitor={"kind": "nodal_solution", "u": ON_STEP}),
            "/initial",
            "leave initial out",
        ),
        "points for a functional": (
            on_step(grid={"points": 99}, monitor={"kind": "nodal_solution", "u": ON_STEP, "adjoint": ON_STEP}),
            "/grid/points",
            "leave points out",
        ),
        "triangles for a functional": (
            on_step(monitor={"kind": "nodal_solution", "u": ON_STEP, "adjoint": ON_STEP}, cells="triangle"),
            "/monitor/adjoint",
            "errors are those on quadrilaterals",
        ),
        **{
            f"cells {cells}": (
                on_step(monitor={"kind": "nodal_solution", "u": {"block_nodes": {**AT_NODES, "block_cells": cells}}}),
                "/monitor/u/block_nodes/block_cells",
                words,
            )
            for cells, words in (
                ([[6, 4]], "equal at common edges"),
                ([[6, 4], [12, 5], [12, 4]], "equal at common edges"),
                ([[60, 4], [12, 4], [12, 4]], "nodes, and there are"),
                ([[2**63, 4], [12, 4], [12, 4]], "whole numbers from 1 to"),
            )
        },
        "an error": (on_step(target={"error": 1e-3}), "/target/error", "give max_points alone"),
        "boundary": (on_step(boundary="orthogonal"), "/boundary", "slide"),
        "metric": (on_step(monitor={"kind": "curvature", "u": "x*y"}), "/monitor", "LeastError"),
        "preset": (
            on_step(monitor={"kind": "auto", "u": "x", "for": "finite_volume"}),
            "/monitor/for",
            "orthogonality",
        ),
        "pole": (on_step(monitor={"u": "1/x"}), "/monitor/u", "not finite", 1),
        "counts that contradict": (other_step(blocks=UNEVEN), "/domain/blocks/1/cells", "the edge b-c has 5 cells"),
        "no such vertex": (other_step(edges=[{"from": "a", "to": "z"}]), "/domain/edges/0/to", "is no vertex"),
        "no block": (other_step(blocks=[]), "/domain/blocks", "1 to"),
        "a file of points": (other_step(curves={"c": {"points": "c.csv"}}), "/domain/curves/c/points", "as a list"),
        "far too many points": (other_step(refine=1e9), "/domain/blocks", "nodes"),
        "unknown key": (other_step(cells=3), "/domain/cells", "known are"),
        "no vertices": (on_step(domain={"kind": "blocks", "blocks": []}), "/domain/vertices", "required"),
        "no file": (on_step(domain={"kind": "mesh"}), "/domain/file", "required"),
        "unknown file": (on_step(domain={"kind": "mesh", "file": "s-1"}), "/domain/file", "no samples"),
        "upload": (on_step(domain={"kind": "mesh", "file": "upload"}), "/domain/file", 'parts "spec" and "mesh"'),
    },
    "schwarz": {
        "large overlap": (schwarz(overlap=8), "/schwarz/overlap", "wider than the overlap"),
        "absurd overlap": (schwarz(overlap=10**12), "/schwarz/overlap", "larger than the grid"),
        "small overlap": (schwarz(overlap=1), "/schwarz/overlap", "at least 2"),
        "many subdomains": (schwarz(subdomains=[9, 1], overlap=2), "/schwarz/subdomains", "do not fit"),
        "absurd subdomains": (schwarz(subdomains=[10**12, 1]), "/schwarz/subdomains", "16"),
        "no subdomain": (schwarz(subdomains=[0, 1]), "/schwarz/subdomains", "at least 1"),
        "three directions": (schwarz(subdomains=[2, 1, 1]), "/schwarz/subdomains", "2 items"),
        "negative p": (schwarz(transmission={"kind": "linear_robin", "p": -2}), "/schwarz/transmission/p", "positive"),
        "word for p": (
            schwarz(transmission={"kind": "linear_robin", "p": "big"}),
            "/schwarz/transmission/p",
            "this must be a positive number, or 'auto'",
        ),
        "p of optimized": (
            schwarz(transmission={"kind": "optimized", "p": 1}),
            "/schwarz/transmission/p",
            "no such key here; known are kind, data",
        ),
        "other data": (
            schwarz(transmission={"kind": "optimized", "data": "all"}),
            "/schwarz/transmission/data",
            "'line_sums' or 'local'",
        ),
        "other line correction": (schwarz(line_correction="some"), "/schwarz/line_correction", "0 to 10, or 'auto'"),
        "many line corrections": (schwarz(line_correction=11), "/schwarz/line_correction", "0 to 10"),
        "fractional line corrections": (schwarz(line_correction=1.5), "/schwarz/line_correction", "whole number"),
        "other acceleration": (schwarz(acceleration="aitken"), "/schwarz/acceleration", "'anderson'"),
        "other local solver": (schwarz(local_solver="direct"), "/schwarz/local_solver", "'sweeps' or 'newton'"),
        "fallback as text": (schwarz(fallback="no"), "/schwarz/fallback", "true or false"),
        "word for tolerance": (schwarz(tolerance="low"), "/schwarz/tolerance", "'discretization', or null"),
        "p of classical": (
            schwarz(transmission={"kind": "classical", "p": 1}),
            "/schwarz/transmission/p",
            "no such key",
        ),
        "other transmission": (schwarz(transmission={"kind": "magic"}), "/schwarz/transmission/kind", "classical"),
        "transmission as text": (schwarz(transmission="classical"), "/schwarz/transmission", "kind"),
        "zero tolerance": (schwarz(tolerance=0), "/schwarz/tolerance", "positive"),
        "no iteration": (schwarz(max_iterations=0), "/schwarz/max_iterations", "at least 1"),
        "subdomains that meet on a side": (schwarz(subdomains=[[0], 1]), "/schwarz/subdomains", "can be cuts"),
        "subdomains as text": (schwarz(subdomains=["2", 1]), "/schwarz/subdomains/0", "a list of grid lines"),
        "other ordering": (schwarz(ordering="random"), "/schwarz/ordering", "'coloured'"),
        "list of settings": (small(schwarz=[]), "/schwarz", ""),
        "unknown setting": (schwarz(subdomain=[2, 1]), "/schwarz/subdomain", "known are"),
        "one count of subdomains": (schwarz(subdomains=2), "/schwarz/subdomains", ""),
        "cuts on the last line": (schwarz(subdomains=[[3, 7], 1]), "/schwarz/subdomains", ""),
        "cuts in lists": (schwarz(subdomains=[[[4]], 1]), "/schwarz/subdomains/0", "grid lines"),
        "fractional overlap": (schwarz(overlap=2.0), "/schwarz/overlap", "whole number"),
        "true for p": (
            schwarz(transmission={"kind": "linear_robin", "p": True}),
            "/schwarz/transmission/p",
            "positive",
        ),
        "list for ordering": (schwarz(ordering=["parallel"]), "/schwarz/ordering", ""),
        "null local solver": (schwarz(local_solver=None), "/schwarz/local_solver", "'newton'"),
        "number for a flag": (schwarz(compare_single_domain=1), "/schwarz/compare_single_domain", "true or false"),
    },
}
# What only a service refuses: more than its settings allow, and texts that no JSON of a solver holds.
OF_A_SERVICE: dict[str, Refusal] = {
    "many points": (small(grid={"n_xi": 200, "n_eta": 200}), "/grid", "20000"),
    "absurd points": (small(grid={"n_xi": 10**30, "n_eta": 8}), "/grid/n_xi", "20000"),
    "endless points": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "grid": {"n_xi": ' + "9" * 9999 + "}}",
        "/grid/n_xi",
        "",
    ),
    "long label": (small(label="x" * 201), "/label", "200"),
    "many points of a target": (
        {**AIMED, "target": {"error": 1, "max_points": 10**9}},
        "/target/max_points",
        "at most",
    ),
    "many points of a shape": ({**AIMED, "grid": {"points": 10**9}}, "/grid/points", "at most 20000 points"),
    "out of reach": (
        {**AIMED, "target": {"error": 1e-9, "max_points": 900}},
        "/target/error",
        "the largest allowed grid, 30 x 30, would give about",
    ),
    "too many samples": (
        on_grid(x=list(np.linspace(0, 1, 5001)), values=[[0, 1]] * 5001),
        "/monitor/u/grid/values",
        "10000",
    ),
    "absurd iterations": (schwarz(max_iterations=10**9), "/schwarz/max_iterations", "at most"),
    "many points for blocks": (on_step(grid={"points": 20001}), "/grid/points", "at most 20000 points: request fewer"),
    "many points of blocks": (other_step(refine=40), "/domain", "at most 20000"),
    "half a character": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "label": "\\ud800"}',
        "/label",
        "surrogate",
    ),
    "a text that no database takes": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "label": "a\\u0000b"}',
        "/label",
        "this text must not hold the character U+0000",
    ),
    "half a key": ('{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "\\udfff": 1}', "", "surrogate"),
    "pointer escapes": (small(**{"a/b~c": 1}), "/a~1b~0c", "no such key"),
    "a list": ([], "", "object"),
    "a number": ("3", "", "object"),
    "null": ("null", "", "object"),
}
