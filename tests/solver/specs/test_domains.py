"""Domains and grids of a document."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from equimesh import AnnulusSector, Blocks, Curve, Domain, InputError, Quadrilateral, Rectangle, Schwarz
from equimesh.specs import build, build_domain, count_points, load
from equimesh.specs.spec import NOT_WITH_BLOCKS

SEAM = {"x": "0", "y": "1 + t"}
O_GRID: dict[str, Any] = {
    "bottom": {"x": "sin(2*pi*t)", "y": "cos(2*pi*t)"},
    "right": SEAM,
    "top": {"x": "2*sin(2*pi*t)", "y": "2*cos(2*pi*t)"},
    "left": SEAM,
    "closed": True,
}
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
        (
            {"kind": "quadrilateral", **O_GRID},
            Quadrilateral(
                bottom=Curve.of_expressions("sin(2*pi*t)", "cos(2*pi*t)"),
                right=Curve.of_expressions("0", "1 + t"),
                top=Curve.of_expressions("2*sin(2*pi*t)", "2*cos(2*pi*t)"),
                left=Curve.of_expressions("0", "1 + t"),
                closed=True,
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
        ({"kind": "quadrilateral", **SIDES, "closed": True}, "domain.closed"),
    ],
)
def test_a_fault_has_the_path_of_the_document(document: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_domain(document)
    assert caught.value.field == field


BLOCKS: dict[str, Any] = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 3]}],
}


def test_blocks_are_counted_before_they_are_made() -> None:
    domain = build_domain({"kind": "blocks", **BLOCKS, "refine": 2})
    assert isinstance(domain, Blocks)
    assert domain.points == count_points({**BLOCKS, "refine": 2}) == 9 * 7
    with pytest.raises(InputError, match="possible") as caught:
        count_points({**BLOCKS, "refine": 1e8})
    assert caught.value.field == "domain.blocks"


def test_files_of_meshes_and_of_points_are_beside_a_problem_file(tmp_path: Path) -> None:
    (tmp_path / "square.json").write_text(json.dumps(BLOCKS))
    (tmp_path / "c.csv").write_text("x, y\n0, 0\n0.5, -0.2\n1, 0\n")
    monitor = {"kind": "least_error", "u": "tanh(9*(x - y))"}
    on_curve = {**BLOCKS, "curves": {"c": {"points": "c.csv"}}, "edges": [{"from": "a", "to": "b", "on": "c"}]}
    for domain, points in (({"kind": "mesh", "file": "square.json"}, 20), ({"kind": "blocks", **on_curve}, 20)):
        (tmp_path / "problem.json").write_text(json.dumps({"monitor": monitor, "domain": domain}))
        built = load(tmp_path / "problem.json")
        assert built.problem.domain.points == points  # type: ignore[union-attr]
        with pytest.raises(InputError, match="four sides"):
            assert built.grid_problem
    with pytest.raises(InputError, match="there is no mesh file named") as caught:
        build_domain({"kind": "mesh", "file": "none.msh"})
    assert caught.value.field == "domain.file"


def test_what_goes_with_a_grid_is_refused_on_blocks() -> None:
    document: dict[str, Any] = {
        "monitor": {"kind": "least_error", "u": "x*y"},
        "domain": {"kind": "blocks", **BLOCKS},
    }
    for name, value in {
        "grid": {"n_xi": 8},
        "target": {"error": 1e-3},
        "boundary": "orthogonal",
        "parts": 2,
    }.items():
        with pytest.raises(InputError) as caught:
            build({**document, name: value})
        assert caught.value.field == name
        assert caught.value.message == NOT_WITH_BLOCKS[name]
    with pytest.raises(InputError, match="LeastError"):
        build({**document, "monitor": {"kind": "curvature", "u": "x*y"}})


def test_schwarz_between_blocks() -> None:
    blocks = {**BLOCKS, "blocks": [{**BLOCKS["blocks"][0], "name": "one"}]}
    document: dict[str, Any] = {"monitor": {"kind": "least_error", "u": "x*y"}, "domain": {"kind": "blocks", **blocks}}
    assert build({**document, "schwarz": {}}).schwarz == Schwarz()
    built = build({**document, "schwarz": {"overlap": 2, "groups": [["one"]]}})
    assert (built.schwarz, built.grid_schwarz) == (Schwarz(overlap=2, groups=[["one"]]), None)
    for settings, field in (
        ({"overlap": 0}, "schwarz.overlap"),
        ({"subdomains": [2, 1]}, "schwarz.subdomains"),
        ({"groups": [["two"]]}, "schwarz.groups[0]"),
        (3, "schwarz"),
    ):
        with pytest.raises(InputError) as caught:
            build({**document, "schwarz": settings})
        assert caught.value.field == field


def test_closed_lines() -> None:
    assert build_domain({"periodic": "y"}) == Rectangle(periodic="y")
    assert build_domain({"kind": "annulus_sector", "closed": True}) == AnnulusSector(closed=True)
