"""Functions of x and y in a document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh import Expression, GridSamples, InputError, Rectangle, SamplesError, ScatteredSamples
from equimesh.specs import build_expression, build_field, no_samples, samples_in

WIDE = Rectangle(x=(0, 2))
GRID: dict[str, Any] = {"x": [0, 1, 2], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 2]]}
SCATTERED: dict[str, Any] = {"points": [[0, 0], [2, 0], [0, 1], [2, 1], [0.9, 0.6]], "values": [0, 1, 2, 3, 4]}


def test_every_source_is_built(tmp_path: Path) -> None:
    np.savez(tmp_path / "u.npz", **GRID)
    find = samples_in(tmp_path)
    expression = {"expression": "k*x + t", "parameters": {"k": 3}, "t": 2}
    assert build_field(expression, WIDE, find) == Expression("k*x + t", parameters={"k": 3}, t=2)
    assert build_expression(expression, WIDE) == build_field(expression, WIDE, find)
    found = (build_field(source, WIDE, find) for source in ({"grid": GRID}, {"samples": "u.npz"}))
    for field in found:
        assert isinstance(field, GridSamples)
        assert field.box == WIDE.box
    assert isinstance(build_field({"scattered": SCATTERED}, WIDE, find), ScatteredSamples)


def test_a_name_tells_the_column_of_a_file(tmp_path: Path) -> None:
    rows = [f"{x} {y} {x * y} {x}" for x in (0, 1, 2) for y in (0, 1)]
    (tmp_path / "flow.txt").write_text("\n".join(["x y T p", *rows]))
    (tmp_path / "odd#p.txt").write_text("\n".join(["x y q", *(row.rpartition(" ")[0] for row in rows)]))
    for name, corner in (("flow.txt#T", 2.0), ("flow.txt#p", 2.0), ("odd#p.txt", 2.0)):
        field = build_field({"samples": name}, WIDE, samples_in(tmp_path))
        assert field.evaluate(np.array(2.0), np.array(1.0))[0] == pytest.approx(corner)
    p = build_field({"samples": "flow.txt#p"}, WIDE, samples_in(tmp_path))
    assert p.evaluate(np.array(2.0), np.array(0.0))[0] == pytest.approx(2.0)
    with pytest.raises(SamplesError, match="choose u from T, p") as caught:
        build_field({"samples": "flow.txt"}, WIDE, samples_in(tmp_path), "monitor.u")
    assert caught.value.columns == ("T", "p")
    (tmp_path / "u.zarr").mkdir()
    with pytest.raises(SamplesError, match="has no columns"):
        build_field({"samples": "u.zarr#T"}, WIDE, samples_in(tmp_path))


@pytest.mark.parametrize(
    ("document", "field"),
    [
        ({}, "rho"),
        ({"expression": "x+*y"}, "rho.expression"),
        ({"expression": 3}, "rho.expression"),
        ({"expression": "1/(x - 1)"}, "rho.expression"),
        ({"expression": "k*x", "parameters": {"k": "3"}}, "rho.parameters.k"),
        ({"expression": "x", "parameters": []}, "rho.parameters"),
        ({"expression": "x", "t": float("nan")}, "rho.t"),
        ({"expression": "x", "grid": GRID}, "rho.grid"),
        ({"grid": {**GRID, "x": [0, 0.5, 1]}}, "rho.grid.x"),
        ({"grid": {"x": [0, 2]}}, "rho.grid.y"),
        ({"grid": {**GRID, "u": 1}}, "rho.grid.u"),
        ({"scattered": {**SCATTERED, "values": [1]}}, "rho.scattered.values"),
        ({"samples": 3}, "rho.samples"),
        ({"samples": "s"}, "rho.samples"),
    ],
)
def test_a_fault_has_the_path_of_the_document(document: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_field(document, WIDE, no_samples, "rho")
    assert caught.value.field == field


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(SamplesError, match="No such file") as caught:
        build_field({"samples": "u.npz"}, WIDE, samples_in(tmp_path), "monitor.u")
    assert caught.value.field == "monitor.u.samples"


def test_a_text_is_an_expression() -> None:
    assert build_field("tanh(20*x)", WIDE, no_samples) == Expression("tanh(20*x)")
    with pytest.raises(InputError) as caught:
        build_field("tanh(20*x", WIDE, no_samples, "monitor.u")
    assert caught.value.field == "monitor.u"
