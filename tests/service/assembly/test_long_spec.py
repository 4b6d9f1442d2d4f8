"""Samples that are taken out of a long spec: what is left names them, and they are in files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_service.assembly.bodies import ShortSpec, SpecLimits, shorten
from equimesh_service.problems.problem import Problem
from service.conftest import small

AXIS = [0, 0.25, 0.5, 0.75, 1]
GRID = {"grid": {"x": AXIS, "y": AXIS, "values": [[x * y for y in AXIS] for x in AXIS]}}
POINTS = [[x, y + 0.01 * x] for x in (-0.2, 0.5, 1.2) for y in (-0.2, 0.5, 1.2)]
SCATTERED = {"scattered": {"points": POINTS, "values": list(range(9))}}
LIMITS = SpecLimits(max_points=1000, max_samples=100)
STORED = {"samples": "s-1"}


def shortened(folder: Path, spec: Any, limits: SpecLimits = LIMITS) -> ShortSpec:
    text = folder / "spec.json"
    text.write_text(json.dumps(spec))
    return shorten(text, folder, limits)


def test_samples_are_in_files_and_the_rest_is_as_it_was(tmp_path: Path) -> None:
    monitor = {"kind": "intersection", "monitors": [{"u": GRID}, {"kind": "weight", "rho": "2", "u": SCATTERED}]}
    short = shortened(tmp_path, small(monitor=monitor, label="long"))
    first, second = short.spec.canonical["monitor"]["monitors"]
    grid, scattered = (np.load(short.files[source["samples"]]) for source in (first["u"], second["u"]))
    np.testing.assert_array_equal(grid["values"], GRID["grid"]["values"])
    np.testing.assert_array_equal(grid["x"], AXIS)
    np.testing.assert_array_equal(scattered["points"], POINTS)
    assert second["rho"] == {"expression": "2", "parameters": {}, "t": 0.0}
    assert short.spec.canonical["label"] == "long"
    assert [short.summaries[name]["kind"] for name in short.files] == ["grid", "scattered"]
    assert short.packed is not None


def test_a_target_gets_the_limit_of_the_service(tmp_path: Path) -> None:
    short = shortened(tmp_path, {"monitor": {"u": GRID}, "target": {"error": 0.1}})
    assert short.spec.canonical["target"]["max_points"] == LIMITS.max_points


def test_with_stored_samples_the_service_has_to_check_it(tmp_path: Path) -> None:
    monitor = {"kind": "tensor", "m11": GRID, "m12": "0", "m22": STORED}
    short = shortened(tmp_path, small(monitor=monitor))
    assert short.packed is None
    assert short.spec.canonical["monitor"]["m22"] == STORED


@pytest.mark.parametrize(
    ("monitor", "pointer", "words"),
    [
        ({"u": {"grid": {**GRID["grid"], "x": [0, 0.25, 0.2, 0.75, 1]}}}, "/monitor/u/grid/x", "must increase"),
        ({"u": {"grid": {**GRID["grid"], "z": 1}}}, "/monitor/u/grid/z", "no such key"),
        ({"u": {"grid": {"x": AXIS, "y": AXIS, "values": [[0] * 101]}}}, "/monitor/u/grid/values", "101 samples"),
        ({"u": {"scattered": {"points": POINTS[:3], "values": [0] * 3}}}, "/monitor/u/scattered/points", "at least"),
        ({"kind": "weight", "rho": "0 -", "u": GRID}, "/monitor/rho", ""),
    ],
)
def test_what_is_wrong_is_told_where_it_was_sent(tmp_path: Path, monitor: Any, pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        shortened(tmp_path, small(monitor=monitor))
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message


def test_more_values_than_samples_can_have_are_not_read(tmp_path: Path) -> None:
    monitor = {"u": {"grid": {"x": [0] * (LIMITS.most_values + 1), "y": [], "values": []}}}
    with pytest.raises(Problem) as caught:
        shortened(tmp_path, small(monitor=monitor))
    assert caught.value.name == "body-too-large"
