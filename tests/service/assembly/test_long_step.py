"""Values at the nodes that are taken out of the JSON of a long step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_service.assembly.bodies import ShortStep, shorten_step
from equimesh_service.problems.problem import Problem

ROWS = [[1.5, 2.5], [3.5, 4.5]]


def shortened(folder: Path, step: Any) -> ShortStep:
    text = folder / "step.json"
    text.write_text(json.dumps(step))
    return shorten_step(text, folder / "step.npz", 1000)


def test_values_are_in_a_file_under_their_names(tmp_path: Path) -> None:
    short = shortened(tmp_path, {"step": 3, "u": {"nodes": ROWS}, "fields": {"p": [[1, 2]], "file": [[3], [4]]}})
    arrays = np.load(tmp_path / "step.npz")
    assert (short.step, short.u, short.sent) == (3, None, {})
    np.testing.assert_array_equal(arrays["u"], ROWS)
    fields = short.fields(arrays)
    assert {name: values.tolist() for name, (values, _) in fields.items()} == {"p": [[1, 2]], "file": [[3], [4]]}


def test_settings_and_the_monitor_stay(tmp_path: Path) -> None:
    field = {"values": [[[1, 2]]], "transfer": "conservative", "location": "cells"}
    monitor = {"kind": "weight", "rho": {"nodes": ROWS}, "smoothing": 0.1}
    short = shortened(tmp_path, {"step": 0, "monitor": monitor, "fields": {"v": field}})
    arrays = np.load(tmp_path / "step.npz")
    assert (short.u, short.monitor) == (None, {**monitor, "rho": {"nodes": "/monitor/rho"}})
    np.testing.assert_array_equal(arrays["/monitor/rho"], ROWS)
    values, settings = short.fields(arrays)["v"]
    assert (values.tolist(), settings.transfer, settings.location) == ([[[1, 2]]], "conservative", "cells")
    assert short.pointers == {"v": "/fields/v/values"}


def test_an_expression_stays(tmp_path: Path) -> None:
    short = shortened(tmp_path, {"step": 0, "u": "tanh(x)", "fields": {"p": ROWS}})
    assert short.u is not None
    assert short.u.expression == "tanh(x)"
    assert short.sent == {"u": "tanh(x)"}
    assert [*np.load(tmp_path / "step.npz")] == ["0"]


@pytest.mark.parametrize(
    ("step", "pointer", "words"),
    [
        ({"step": 0, "u": {"nodes": [[1, 2], [3]]}}, "/u/nodes", "the same length"),
        ({"step": 0, "u": "x", "fields": {"a/b": [[1], [2, 3]]}}, "/fields/a~1b", "the same length"),
        ({"step": "0", "u": "x"}, "/step", "whole number"),
    ],
)
def test_what_is_wrong_is_told_where_it_was_sent(tmp_path: Path, step: Any, pointer: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        shortened(tmp_path, step)
    (complaint,) = caught.value.errors
    assert complaint.pointer == pointer
    assert words in complaint.message
