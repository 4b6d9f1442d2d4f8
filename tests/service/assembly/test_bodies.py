"""Samples that are taken out of a long spec: what is left names them, and they are in files."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh_service.assembly.bodies import (
    ShortSpec,
    ShortStep,
    SpecLimits,
    StepField,
    checked_values,
    field_arrays,
    read_fields,
    shorten,
    shorten_step,
    unpack,
)
from equimesh_service.problems.problem import Problem
from service.conftest import small
from service.requests import STEP

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
    assert short.built is not None


def test_a_target_gets_the_limit_of_the_service(tmp_path: Path) -> None:
    short = shortened(tmp_path, {"monitor": {"u": GRID}, "target": {"error": 0.1}})
    assert short.spec.canonical["target"]["max_points"] == LIMITS.max_points


def test_too_many_points_are_refused_where_they_were_sent(tmp_path: Path) -> None:
    for more, pointer in (
        ({"grid": {"points": 1001}}, "/grid/points"),
        ({"target": {"max_points": 1001}}, "/target/max_points"),
    ):
        with pytest.raises(Problem, match="at most 1000") as refused:
            shortened(tmp_path, {"monitor": {"u": GRID}, **more})
        assert [fault.pointer for fault in refused.value.errors] == [pointer]


def test_with_stored_samples_the_service_has_to_check_it(tmp_path: Path) -> None:
    monitor = {"kind": "tensor", "m11": GRID, "m12": "0", "m22": STORED}
    short = shortened(tmp_path, small(monitor=monitor))
    assert short.built is None
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


# Values at the nodes that are taken out of the JSON of a long step.


ROWS = [[1.5, 2.5], [3.5, 4.5]]
BAD_ROWS = [[1, 2], [None, 4]]


def shortened_step(folder: Path, step: Any) -> ShortStep:
    text = folder / "step.json"
    text.write_text(json.dumps(step))
    return shorten_step(text, folder / "step.npz", 1000)


def test_values_are_in_a_file_under_their_names(tmp_path: Path) -> None:
    short = shortened_step(tmp_path, {"step": 3, "u": {"nodes": ROWS}, "fields": {"p": [[1, 2]], "file": [[3], [4]]}})
    arrays = np.load(tmp_path / "step.npz")
    assert (short.step, short.u, short.sent) == (3, None, {})
    np.testing.assert_array_equal(arrays["u"], ROWS)
    fields = short.fields(arrays)
    assert {name: values.tolist() for name, (values, _) in fields.items()} == {"p": [[1, 2]], "file": [[3], [4]]}


def test_settings_and_the_monitor_stay(tmp_path: Path) -> None:
    field = {"values": [[[1, 2]]], "transfer": "conservative", "location": "cells"}
    monitor = {"kind": "weight", "rho": {"nodes": ROWS}, "smoothing": 0.1}
    short = shortened_step(tmp_path, {"step": 0, "monitor": monitor, "fields": {"v": field}})
    arrays = np.load(tmp_path / "step.npz")
    assert (short.u, short.monitor) == (None, {**monitor, "rho": {"nodes": "/monitor/rho"}})
    np.testing.assert_array_equal(arrays["/monitor/rho"], ROWS)
    values, settings = short.fields(arrays)["v"]
    assert (values.tolist(), settings.transfer, settings.location) == ([[[1, 2]]], "conservative", "cells")
    assert short.pointers == {"v": "/fields/v/values"}


def test_an_expression_stays(tmp_path: Path) -> None:
    short = shortened_step(tmp_path, {"step": 0, "u": "tanh(x)", "fields": {"p": ROWS}})
    assert short.u.expression == "tanh(x)"
    assert short.sent == {"u": "tanh(x)"}
    assert [*np.load(tmp_path / "step.npz")] == ["0"]


@pytest.mark.parametrize(
    ("step", "pointer", "words"),
    [
        ({"step": 0, "u": {"nodes": [[1, 2], [3]]}}, "/u/nodes", "the same length"),
        ({"step": 0, "u": "x", "fields": {"a/b": [[1], [2, 3]]}}, "/fields/a~1b", "the same length"),
        (
            {"step": 0, "u": {"nodes": [1, 2]}},
            "/u/nodes/0",
            "this must be a list of numbers: a table is a list of rows",
        ),
        ({"step": 0, "monitor": {"kind": "weight", "rho": {"nodes": BAD_ROWS}}}, "/monitor/rho/nodes/1/0", "is null"),
        ({"step": "0", "u": "x"}, "/step", "whole number"),
    ],
)
def test_what_is_wrong_in_a_step_is_told_where_it_was_sent(tmp_path: Path, step: Any, pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        shortened_step(tmp_path, step)
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message


# Requests in one npz: the spec is taken out, and the other arrays are the samples.


SPEC = {"monitor": {"kind": "arc_length", "u": {"samples": "upload"}}, "grid": {"n_xi": 9, "n_eta": 9}, "label": "é"}
PACKED_AXIS = np.linspace(0.0, 1.0, 9)
SAMPLES = {"x": PACKED_AXIS, "y": PACKED_AXIS, "values": np.tanh(5 * np.add.outer(PACKED_AXIS, -PACKED_AXIS))}


def packed(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "text",
    [
        np.array(json.dumps(SPEC)),
        np.array([json.dumps(SPEC)]),
        np.array(json.dumps(SPEC).encode()),
        np.frombuffer(json.dumps(SPEC, ensure_ascii=False).encode(), np.uint8),
    ],
)
def test_the_spec_is_a_text_or_its_bytes(text: Any) -> None:
    data = packed(spec=text, **SAMPLES)
    spec, upload = unpack(data)
    assert json.loads(spec) == SPEC
    assert (upload.data, upload.filename) == (data, "samples.npz")


def test_a_spec_alone_has_no_samples() -> None:
    assert unpack(packed(spec=json.dumps(SPEC)))[1] is None


@pytest.mark.parametrize(
    ("data", "kind", "said"),
    [
        (packed(**SAMPLES), "malformed-body", "no array 'spec'"),
        (b"not a zip", "invalid-input", "npz"),
        (packed(spec=np.array([1.5, 2.5])), "invalid-input", "one text"),
        (packed(spec=np.array(["a", "b"])), "invalid-input", "one text"),
        (packed(spec=np.array([None], dtype=object)), "invalid-input", "one text"),
        (packed(spec=np.arange(4, dtype=np.uint16)), "invalid-input", "one text"),
        (packed(spec="ab").replace(b"<U2", b"<U9"), "invalid-input", "npz"),
        (packed(spec="x" * 2_000_000), "invalid-input", "more than the bytes allowed"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, kind: str, said: str) -> None:
    with pytest.raises(Problem) as caught:
        unpack(data)
    assert caught.value.name == kind
    assert said in str(caught.value.body())


def test_the_service_makes_the_same_mesh_of_both_forms(http: httpx.Client) -> None:
    headers = {"Prefer": "wait=300"}
    body = packed(spec=json.dumps(SPEC), **SAMPLES)
    sent = {"spec": (None, json.dumps(SPEC), "application/json"), "samples": ("u.npz", packed(**SAMPLES))}
    path = "/v1/meshes?format=npz&reuse=false"
    one = http.post(path, content=body, headers={**headers, "Content-Type": "application/x-npz"})
    two = http.post(path, files=sent, headers=headers)
    assert (one.status_code, two.status_code) == (201, 201)
    assert one.headers["etag"] == two.headers["etag"]
    names = [part.partition(";")[0] for part in one.headers["server-timing"].split(", ")]
    assert {"receive", "check", "solve", "quality", "commit", "answer"} <= {*names}


# Fields of a step: checked against a mesh, and written to a file.


MESH = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
NODES, CELLS = np.arange(20.0).reshape(5, 4), np.arange(12.0).reshape(4, 3)
BAD = NODES.copy()
BAD[2, 3] = np.nan


@pytest.mark.parametrize(
    ("values", "location", "words"),
    [
        (BAD, "nodes", r"p\[2\]\[3\] is NaN \(1 of 20 values are not finite\), as from a solver that diverged"),
        (NODES.T, "nodes", "transpose it"),
        (NODES[:3], "nodes", r"shape \(3, 4\), but a value at each node is needed, shape \(5, 4\), xi first$"),
        (CELLS, "nodes", "one value for each of the cells, and is sent as nodes: give it the location cells"),
        (NODES, "cells", "one value for each of the nodes, and is sent as cells: give it the location nodes"),
        (NODES.ravel(), "nodes", r"shape \(5, 4\), xi first; reshape it"),
        (NODES.ravel().tolist(), "nodes", r"shape \(5, 4\), xi first; reshape it"),
        (np.ones((5, 4, 17)), "nodes", "vectors of 17 components"),
        (1e200 * NODES, "nodes", r"p\[0\]\[1\] = 1e\+200"),
        ([[1.0, 2.0], [3.0]], "nodes", "the same length"),
    ],
)
def test_values_that_do_not_belong_to_the_mesh(values: Any, location: Any, words: str) -> None:
    with pytest.raises(SamplesError, match=words):
        StepField(values=values, transfer="conservative", location=location).checked(MESH, "p")


def test_averages_have_no_spline() -> None:
    with pytest.raises(SamplesError, match="p has averages of cells, which have no spline"):
        StepField(values=CELLS, location="cells").checked(MESH, "p")


@pytest.mark.parametrize(
    ("transfer", "bounds", "words"),
    [
        ("spline", (0.0, 20.0), "only the conservative transfer keeps bounds"),
        ("conservative", (0.0, 1.0), "p lies between 0 and 19, its bounds are 0 and 1"),
        ("conservative", (1.0, 0.0), "the least and the largest value"),
    ],
)
def test_bounds_that_do_not_hold(transfer: Any, bounds: tuple[float, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        StepField(values=NODES, transfer=transfer, bounds=bounds).checked(MESH, "p")


def test_what_is_right_stays_as_it_is() -> None:
    for values in (NODES, NODES.tolist(), np.stack([NODES, -NODES], axis=-1), [[[1, 2]] * 4] * 5):
        np.testing.assert_array_equal(checked_values(values, MESH, "p"), values)


def test_fields_are_read_as_they_were_written(tmp_path: Path) -> None:
    fields = {
        "p": StepField(values=NODES),
        "q": StepField(values=CELLS, transfer="conservative", location="cells", bounds=(-1.0, 20.0)),
        "v": StepField(values=np.stack([NODES, NODES], axis=-1), transfer="conservative"),
    }
    np.savez(tmp_path / "fields.npz", **field_arrays(fields))
    found = read_fields(tmp_path / "fields.npz")
    assert [*found] == [*fields]
    for name, field in fields.items():
        assert found[name].settings == field.settings
        np.testing.assert_array_equal(found[name].values, field.values)


def test_usual_fields_are_written_as_in_the_release_before(tmp_path: Path) -> None:
    np.savez(tmp_path / "fields.npz", **field_arrays({"p": StepField(values=NODES)}))
    np.savez(tmp_path / "before.npz", p=NODES)
    assert (tmp_path / "fields.npz").read_bytes() == (tmp_path / "before.npz").read_bytes()


def test_values_on_blocks_are_rows_of_one_number_or_plain_arrays() -> None:
    mesh = em.Blocks.of(STEP).mesh
    u, vectors = mesh.x, mesh.points
    for given in (u, u[:, None], u[:, None].tolist()):
        np.testing.assert_array_equal(checked_values(given, mesh, "u", vectors=False), u)
    for given in (vectors, vectors[:, None], vectors[:, None].tolist()):
        np.testing.assert_array_equal(checked_values(given, mesh, "v"), vectors)
    with pytest.raises(em.SamplesError, match="one number"):
        checked_values(vectors, mesh, "u", vectors=False)
    with pytest.raises(em.SamplesError, match="as many as the cells"):
        checked_values(np.ones(len(mesh.cells)), mesh, "u")
    with pytest.raises(em.SamplesError, match="rescale"):
        checked_values(np.full(len(u), 1e300), mesh, "u")
