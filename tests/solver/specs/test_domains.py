"""Domains and grids of a document."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh import AnnulusSector, Curve, Domain, InputError, Quadrilateral, Rectangle
from equimesh.specs import build_domain

SIDES: dict[str, Any] = {
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"points": [[0, 1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}


@pytest.mark.parametrize(
    ("document", "domain"),
    [
        ({}, Rectangle()),
        ({"kind": "rectangle", "x": [0, 2]}, Rectangle(x=(0, 2))),
        ({"kind": "annulus_sector"}, AnnulusSector()),
        (
            {"kind": "annulus_sector", "center": [1, 0], "radii": [1, 3], "angles": [0, 45]},
            AnnulusSector(center=(1, 0), radii=(1, 3), angles=(0, 45)),
        ),
        (
            {"kind": "quadrilateral", **SIDES},
            Quadrilateral(
                bottom=Curve.of_expressions("t", "h*sin(pi*t)", {"h": 0.2}),
                right=Curve.through([[1, 0], [1, 1]]),
                top=Curve.through([[0, 1], [1, 1]]),
                left=Curve.of_expressions("0", "t"),
            ),
        ),
    ],
)
def test_every_domain_is_built(document: dict[str, Any], domain: Domain) -> None:
    assert build_domain(document) == domain


@pytest.mark.parametrize(
    ("document", "field"),
    [
        ({"kind": "disk"}, "domain.kind"),
        ({"x": [1, 0]}, "domain.x"),
        ({"radii": [1, 2]}, "domain.radii"),
        ({"kind": "annulus_sector", "radii": "12"}, "domain.radii"),
        ({"kind": "quadrilateral"}, "domain.bottom"),
        ({"kind": "quadrilateral", **SIDES, "left": {"points": [[0, 0]]}}, "domain.left.points"),
        ({"kind": "quadrilateral", **SIDES, "left": {"x": "0"}}, "domain.left.y"),
        ({"kind": "quadrilateral", **SIDES, "left": {"x": "0", "y": "t+*1"}}, "domain.left.y"),
        ({"kind": "quadrilateral", **SIDES, "left": {"x": "0", "y": 3}}, "domain.left.y"),
        ({"kind": "quadrilateral", **SIDES, "left": {"points": [[0, 0], [0, 0.9]]}}, "domain.left"),
    ],
)
def test_a_fault_has_the_path_of_the_document(document: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_domain(document)
    assert caught.value.field == field
