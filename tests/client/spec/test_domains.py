"""Domains of the client: their JSON, their boxes, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from equimesh_client import AnnulusSector, BadArgument, Quadrilateral, Rectangle
from equimesh_client.spec.domains import box_around, domain_json, read_domain

ROUND = Quadrilateral(
    bottom=("1+t", "0"),
    right=("2*cos(a*t)", "2*sin(a*t)", {"a": 1.5}),
    top=[[0.0, 1.0], [0.0, 2.0]],
    left=np.array([[1.0, 0.0], [0.7, 0.7], [0.0, 1.0]]),
)


def test_domains_as_json() -> None:
    assert domain_json(Rectangle(x=(-1, 2))) == {"kind": "rectangle", "x": [-1, 2], "y": [0, 1], "periodic": None}
    assert domain_json(AnnulusSector(angles=(0, 45))) == {
        "kind": "annulus_sector",
        "center": [0, 0],
        "radii": [1, 2],
        "angles": [0, 45],
        "closed": False,
    }
    assert domain_json(ROUND) == {
        "kind": "quadrilateral",
        "bottom": {"x": "1+t", "y": "0"},
        "right": {"x": "2*cos(a*t)", "y": "2*sin(a*t)", "parameters": {"a": 1.5}},
        "top": {"points": [[0, 1], [0, 2]]},
        "left": {"points": [[1, 0], [0.7, 0.7], [0, 1]]},
        "closed": False,
    }
    assert domain_json({"kind": "rectangle"}) == {"kind": "rectangle"}


@pytest.mark.parametrize("domain", [Rectangle(x=(0, 3)), AnnulusSector(center=(1, 2)), ROUND])
def test_json_is_read_back(domain: Any) -> None:
    assert domain_json(read_domain(domain_json(domain))) == domain_json(domain)


@pytest.mark.parametrize("angles", [(0, 90), (-30, 30), (10, 80), (80, 300), (0, 360), (-200, -100), (630, 700)])
def test_the_box_of_a_sector_holds_it_and_no_more(angles: tuple[float, float]) -> None:
    domain = AnnulusSector(center=(5, -1), radii=(0.5, 2), angles=angles)
    turn = np.radians(np.linspace(*angles, 20_001))
    x, y = 5 + np.outer([0.5, 2], np.cos(turn)), -1 + np.outer([0.5, 2], np.sin(turn))
    box = box_around(domain)
    assert box is not None
    (x0, x1), (y0, y1) = box
    assert np.allclose((x0, x1, y0, y1), (x.min(), x.max(), y.min(), y.max()), atol=1e-7)
    assert x0 <= x.min() + 1e-12
    assert y1 >= y.max() - 1e-12


def test_boxes_agree_with_the_solver() -> None:
    em = pytest.importorskip("equimesh")
    for center, radii, angles in (((0, 0), (1, 2), (0, 90)), ((3, 4), (0.1, 7), (-100, 200.5))):
        ours = box_around(AnnulusSector(center=center, radii=radii, angles=angles))
        theirs = em.AnnulusSector(center=center, radii=radii, angles=angles).box
        assert ours is not None
        assert np.allclose(ours, theirs, rtol=0, atol=1e-14 * math.hypot(*center, 7) * 10)
    assert box_around(ROUND) is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: domain_json(Rectangle(x=(0, 1, 2))), "x of a domain is a pair"),  # type: ignore[arg-type]
        (lambda: domain_json(AnnulusSector(radii="ab")), "radii of a domain is a pair"),  # type: ignore[arg-type]
        (lambda: domain_json("disk"), "a domain is a Rectangle"),  # type: ignore[arg-type]
        (lambda: domain_json(Quadrilateral(bottom="t", right=0, top=0, left=0)), "bottom is a pair of formulas"),
        (lambda: domain_json(Quadrilateral(bottom=[[0, math.nan]], right=0, top=0, left=0)), "bottom is a pair"),
        (lambda: read_domain([]), "JSON object"),
        (lambda: read_domain({"kind": "disk"}), "unknown kind of domain 'disk'; there are rectangle"),
        (lambda: read_domain({"kind": "rectangle", "z": 1}), "has no z; it has x, y, periodic"),
        (lambda: read_domain({"x": 3}), "pair of numbers"),
        (lambda: read_domain({"periodic": "z"}), "periodic of a domain is one of None, 'x', 'y', 'both'"),
        (lambda: read_domain({"kind": "annulus_sector", "closed": 1}), "closed of a domain is one of False, True"),
        (lambda: read_domain({"kind": "quadrilateral", "left": {"points": []}}), "needs bottom, right, top"),
        (lambda: read_domain({**domain_json(ROUND), "left": [[0, 0]]}), "left must be"),
        (lambda: read_domain({**domain_json(ROUND), "closed": 1}), "closed of a domain is one of False, True"),
    ],
)
def test_what_is_refused(make: Any, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        make()


def test_closed_lines_as_json_and_back() -> None:
    for domain, closed in (
        (Rectangle(periodic="both"), {"periodic": "both"}),
        (AnnulusSector(closed=True), {"closed": True, "angles": [0, 360]}),
    ):
        document = domain_json(domain)
        assert closed.items() <= document.items()
        assert read_domain(document) == domain
    around = domain_json(replace(ROUND, closed=True))
    assert around["closed"] is True
    assert domain_json(read_domain(around)) == around
    assert read_domain({"kind": "annulus_sector", "closed": True}) == AnnulusSector(closed=True)
