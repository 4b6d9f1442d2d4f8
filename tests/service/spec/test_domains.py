"""Bad domains are refused with the place of the mistake."""

from __future__ import annotations

import httpx
import pytest

from service.conftest import small
from service.spec.bad_specs import (
    LINE,
    Refusal,
    between,
    expect_refusal,
    on,
)

DOMAINS: dict[str, Refusal] = {
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
}


@pytest.mark.parametrize("name", DOMAINS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, DOMAINS[name])
