"""What a time-stepper sends, read from JSON and from npz, and compared with the mesh."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh_service.admission.steps import read_arrays, read_json
from equimesh_service.problems.problem import Problem
from service.requests import npz

U = np.arange(12.0).reshape(4, 3)


def test_a_step_is_the_same_in_json_and_in_npz() -> None:
    move = read_json(b'{"step": 3, "u": {"nodes": [[1, 2], [3, 4]]}, "fields": {"v": [[5, 6], [7, 8]]}}')
    arrays = read_arrays(npz(step=3, u=[[1.0, 2.0], [3.0, 4.0]], v=[[5.0, 6.0], [7.0, 8.0]]), 10_000)
    assert move.step == arrays.step == 3
    np.testing.assert_array_equal(move.u, arrays.u)
    assert move.fields.keys() == arrays.fields.keys() == {"v"}
    np.testing.assert_array_equal(move.fields["v"].values, arrays.fields["v"].values)


def test_settings_say_the_same_in_json_and_in_npz() -> None:
    monitor = {"kind": "weight", "rho": {"nodes": "r"}, "u": {"field": "v"}}
    settings = {"monitor": monitor, "fields": {"v": {"transfer": "conservative"}}}
    values = {"r": [[1.0, 2.0], [3.0, 4.0]], "v": [[5.0, 6.0], [7.0, 8.0]]}
    packed = read_arrays(npz(step=0, settings=json.dumps(settings), **values), 10_000)
    sent = {"step": 0, "monitor": {**monitor, "rho": {"nodes": values["r"]}}}
    written = read_json(
        json.dumps({**sent, "fields": {"v": {"values": values["v"], "transfer": "conservative"}}}).encode()
    )
    mesh = em.Mesh(*np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij"))
    for move in (packed, written):
        checked = move.check(mesh)
        assert (checked.u, [*checked.fields], checked.fields["v"].transfer) == (None, ["v"], "conservative")
        np.testing.assert_array_equal(checked.monitor["rho"], values["r"])
        np.testing.assert_array_equal(checked.monitor["u"], values["v"])


def test_an_array_called_settings_is_a_field_unless_it_is_a_text() -> None:
    assert [*read_arrays(npz(step=0, u=U, settings=U), 10_000).fields] == ["settings"]
    for text in ('{"u": {"expression": "x"}}', b'{"u": "x"}'):
        move = read_arrays(npz(step=0, settings=text), 10_000)
        assert (move.u.expression, move.fields) == ("x", {})


def test_the_answer_of_the_step_before_may_come_back_with_its_fields() -> None:
    answer = np.frombuffer(b'{"status": "succeeded"}', np.uint8)
    assert [*read_arrays(npz(step=1, u=U, p=U, step_json=answer), 10_000).fields] == ["p"]
    assert read_json(b'{"step": 1, "u": "x", "fields": {"step_json": [1, 2]}}').fields == {}


@pytest.mark.parametrize(
    ("arrays", "pointer", "words"),
    [
        ({"u": U}, "/step", "needs an array step"),
        ({"step": 1}, "/u", "needs an array u"),
        ({"step": [1, 2], "u": U}, "/step", "a single whole number"),
        ({"step": 1.0, "u": U}, "/step", "a single whole number"),
        ({"step": 1, "u": U, "settings": "{"}, "/settings", "not JSON"),
        ({"step": 1, "u": U, "settings": '{"u": "x"}'}, "/u", "there is an array u"),
        ({"step": 1, "u": U, "settings": '{"fields": {"w": {}}}'}, "/fields/w", "no array of this name"),
        ({"step": 1, "settings": '{"monitor": {"rho": {"nodes": "w"}}}'}, "/monitor/rho/nodes", "no array 'w'"),
        ({"step": 1, "u": U} | {f"v{k}": U for k in range(33)}, "/fields", "at most 32"),
    ],
)
def test_what_is_no_step_is_refused(arrays: dict[str, Any], pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        read_arrays(npz(**arrays), 100_000)
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message


MESH = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
CELLS = np.ones((4, 3))


@pytest.mark.parametrize(
    ("step", "pointer", "words"),
    [
        ({}, "/u", "unless the step has a monitor"),
        ({"u": {"field": "p"}}, "/u/field", "its fields are: none"),
        (
            {"u": {"nodes": CELLS.tolist()}},
            "/u/nodes",
            "one value for each of the cells, and a monitor needs one for each of the nodes",
        ),
        ({"u": "x", "fields": {"rho": CELLS.tolist()}}, "/fields/rho", "rho has one value for each of the cells"),
        (
            {"u": {"field": "p"}, "fields": {"p": {"values": CELLS.tolist(), "location": "cells"}}},
            "/u/field",
            "p has averages of cells",
        ),
        ({"u": {"field": "p"}, "fields": {"p": [[[1, 2]] * 4] * 5}}, "/u/field", "p has vectors"),
        ({"u": "x", "fields": {f"v{k}": [[[1] * 9] * 4] * 5 for k in range(8)}}, "/fields", "72 components"),
    ],
)
def test_what_does_not_belong_to_the_mesh_is_refused(step: dict[str, Any], pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        read_json(json.dumps({"step": 0, **step}).encode()).check(MESH)
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message
