"""What `u` may be, and what is refused before anything is sent."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument
from equimesh_client.spec.sources import MAX_INLINE_VALUES, SampleFile, StoredSamples, source_of, upload_of

AXIS = [0.0, 0.5, 1.0]


def test_an_expression() -> None:
    assert source_of("x").json == {"expression": "x"}
    given = source_of("c*x+t", parameters={"c": np.float32(2)}, t=1)  # type: ignore[dict-item]
    assert given.json == {"expression": "c*x+t", "parameters": {"c": 2.0}, "t": 1.0}


def test_an_array_lies_on_the_uniform_grid_first_index_along_x() -> None:
    grid = source_of(np.arange(6).reshape(3, 2)).json["grid"]
    assert grid == {"x": AXIS, "y": [0.0, 1.0], "values": [[0, 1], [2, 3], [4, 5]]}
    assert source_of([[0, 1], [2, 3], [4, 5]]).json["grid"] == grid


@pytest.mark.parametrize("form", [lambda x, y, v: (x, y, v), lambda x, y, v: {"x": x, "y": y, "values": v}])
def test_a_rectilinear_grid(form: Any) -> None:
    values = np.ones((3, 2))
    json = source_of(form(np.array([0, 0.2, 1]), [0, 1], values)).json
    assert json == {"grid": {"x": [0, 0.2, 1], "y": [0, 1], "values": values.tolist()}}


def test_scattered_points_three_ways() -> None:
    points, values = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [1.0, 2.0, 3.0]
    x, y = zip(*points, strict=True)
    expected = {"scattered": {"points": points, "values": values}}
    for u in ((points, values), {"points": points, "values": values}, (x, y, values)):
        assert source_of(u).json == expected


def test_a_callable_is_called_once_with_arrays() -> None:
    calls = []

    def u(x: Any, y: Any) -> Any:
        calls.append((x.shape, y.shape))
        return x - y

    source = source_of(u, n_samples=5)
    assert calls == [((5, 5), (5, 5))]
    assert source.json["grid"]["values"][4][0] == 1.0
    assert source.json["grid"]["values"][0][4] == -1.0


def test_a_constant_callable_is_fine() -> None:
    assert source_of(lambda x, _: 3 + 0 * x[0, 0], n_samples=2).json["grid"]["values"] == [[3, 3], [3, 3]]


def test_a_callable_of_numbers_only_is_told_what_to_do() -> None:
    with pytest.raises(BadArgument, match=r"numpy\.vectorize"):
        source_of(lambda x, y: math.sin(x) * y)
    with pytest.raises(BadArgument, match=r"numpy\.vectorize"):
        source_of(lambda *_: np.ones(7))


def test_a_fault_inside_a_callable_is_not_hidden() -> None:
    def u(*_: Any) -> Any:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        source_of(u)


def test_samples_go_inline_up_to_a_size() -> None:
    n = math.isqrt(MAX_INLINE_VALUES) - 2
    assert source_of(np.ones((n, n))).upload is None
    big = source_of(np.ones((n + 5, n + 5)))
    assert big.json == {"samples": "upload"}
    with np.load(io.BytesIO(big.upload.data), allow_pickle=False) as file:
        assert sorted(file) == ["values", "x", "y"]


def test_the_same_samples_give_the_same_bytes() -> None:
    assert upload_of(np.ones((9, 9))) == upload_of(np.ones((9, 9)))


def test_stored_samples_and_files(tmp_path: Path) -> None:
    assert source_of(StoredSamples(id="s1", record={})).json == {"samples": "s1"}
    path = tmp_path / "u.csv"
    path.write_text("x,y,u\n")
    source = source_of(path)
    assert source.json == {"samples": "upload"}
    assert (source.upload.filename, source.upload.data, source.upload.column) == ("u.csv", b"x,y,u\n", None)
    chosen = source_of(SampleFile(path, "T")).upload
    assert (chosen.filename, chosen.data, chosen.column) == ("u.csv", b"x,y,u\n", "T")
    assert upload_of(SampleFile(str(path), "T")) == chosen


NAN = np.ones((3, 3))
NAN[1, 2] = np.nan


@pytest.mark.parametrize(
    ("u", "words"),
    [
        (NAN, r"values\[1, 2\] is nan"),
        ([0.0, math.inf], "two dimensions"),
        (([0.0, math.inf], AXIS, np.ones((2, 3))), r"x\[1\] is inf"),
        (np.ones(3), "two dimensions"),
        (np.ones((3, 1)), "at least 2"),
        (np.ones((3, 3)) * 1j, "complex"),
        (np.ma.masked_equal(np.eye(3), 1.0), "masked"),
        ({"nodes": np.eye(2), "values": [1, 2], "block_cells": [[4.5, 4]]}, "whole numbers"),
        ({"nodes": np.eye(2), "values": [1, 2], "block_cells": [[np.inf, 4]]}, "whole numbers"),
        (lambda x, y: x + 1j * y, "complex"),
        ([["a", "b"]], "real numbers"),
        ([[1, 2], [3]], "real numbers"),
        ((AXIS, AXIS, [1.0, 2.0]), "common length"),
        ((np.ones((3, 3)), np.ones((3, 3)), np.ones((3, 4))), "one common shape"),
        ((np.ones((3, 3)), np.ones(3), np.ones((3, 3))), "two axes"),
        ((1,), "tuple"),
        ({"x": AXIS}, "keys"),
        (None, "u is an expression"),
        (lambda *_: None, r"u\(x, y\) is None: it has to return its values"),
        (3.0, "u is an expression"),
        (Path("missing.npz"), "missing.npz"),
        (Path("mesh.doc"), "samples are read from"),
    ],
)
def test_what_is_refused(u: object, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        source_of(u)


def test_options_that_do_not_belong() -> None:
    with pytest.raises(BadArgument, match="belong to an expression"):
        source_of(np.ones((3, 3)), t=1.0)
    with pytest.raises(BadArgument, match=r"parameters = \[3\]: give numbers by their names"):
        source_of("c*x", parameters=[3])  # type: ignore[arg-type]
    with pytest.raises(BadArgument, match="n_samples"):
        source_of(lambda x, _: x, n_samples=1)
    with pytest.raises(BadArgument, match="not samples"):
        upload_of("u.csv")


def test_what_looks_like_something_else_is_told() -> None:
    with pytest.raises(BadArgument, match=r"table of x, y and u: give \(table\[:, :2\], table\[:, 2\]\)"):
        source_of(np.ones((20, 3)))
    assert source_of(np.ones((3, 3))).json is not None
    with pytest.raises(BadArgument, match=r"name of a file: give pathlib.Path\('u.npz'\)"):
        source_of("u.npz")
