"""Specs of every monitor and every domain, which are solved."""

from __future__ import annotations

from typing import Any

from service.requests import CURVED

FRONT = {"expression": "tanh(8*(x - y))"}
ARC: dict[str, Any] = {"kind": "arc_length", "u": FRONT}
CURVATURE: dict[str, Any] = {"kind": "curvature", "u": FRONT, "norm": "h1"}
WEIGHT: dict[str, Any] = {"kind": "weight", "rho": {"expression": "1 + x*x + y"}}
TENSOR: dict[str, Any] = {
    "kind": "tensor",
    "m11": {"expression": "1 + x*x"},
    "m12": {"expression": "0.1"},
    "m22": {"expression": "2"},
}
MONITORS: dict[str, dict[str, Any]] = {
    "auto": {"kind": "auto", "u": "tanh(20*(x + y/2 - 0.75))", "norm": "h1"},
    "least error": {"kind": "least_error", "u": {"expression": "tanh(20*(x + y/2 - 0.75))"}, "smoothness": 0.5},
    "arc_length": ARC,
    "smooth arc_length": {**ARC, "smoothing": 0.1},
    "curvature": CURVATURE,
    "isotropic curvature": {"kind": "curvature", "u": FRONT, "isotropic": True, "smoothing": 0.02},
    "weight": WEIGHT,
    "weight with u": {**WEIGHT, "u": FRONT},
    "tensor": TENSOR,
    "intersection": {
        "kind": "intersection",
        "monitors": [ARC, WEIGHT, {**TENSOR, "smoothing": 0.1}],
        "smoothing": 0.05,
    },
}
DOMAINS: dict[str, dict[str, Any]] = {
    "unit square": {"kind": "rectangle"},
    "rectangle": {"kind": "rectangle", "x": [-1, 1], "y": [0, 3]},
    "annulus_sector": {"kind": "annulus_sector", "radii": [0.5, 1.5], "angles": [-20, 100]},
    "quadrilateral": CURVED,
}
