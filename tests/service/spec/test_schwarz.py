"""The Schwarz iteration over HTTP: every choice of the solver, what is recorded, and what a fallback says."""

from __future__ import annotations

import httpx
import pytest

from service.spec.bad_specs import Refusal, expect_refusal, schwarz

SETTINGS: dict[str, Refusal] = {
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
    "p of classical": (schwarz(transmission={"kind": "classical", "p": 1}), "/schwarz/transmission/p", "no such key"),
    "other transmission": (schwarz(transmission={"kind": "magic"}), "/schwarz/transmission/kind", "classical"),
    "transmission as text": (schwarz(transmission="classical"), "/schwarz/transmission", "kind"),
    "zero tolerance": (schwarz(tolerance=0), "/schwarz/tolerance", "positive"),
    "no iteration": (schwarz(max_iterations=0), "/schwarz/max_iterations", "at least 1"),
    "absurd iterations": (schwarz(max_iterations=10**9), "/schwarz/max_iterations", "at most"),
    "subdomains that meet on a side": (schwarz(subdomains=[[0], 1]), "/schwarz/subdomains", "can be cuts"),
    "subdomains as text": (schwarz(subdomains=["2", 1]), "/schwarz/subdomains/0", "a list of grid lines"),
    "other ordering": (schwarz(ordering="random"), "/schwarz/ordering", "'coloured'"),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, SETTINGS[name])
