"""Uploaded samples: every file type in every spelling people send, and broken files."""

from __future__ import annotations

import io
import json
import pickle
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.fields.nodal_field import NodalField
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.upload.samples import MAX_BYTES, READERS, read_arrays, read_npz, read_samples
from solver.domains.shapes import refusal
from solver.fields.tables import BOX, on_box
from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import (
    CLOUD,
    CLOUD_U,
    GRID_POINTS,
    TABLE,
    X,
    Y,
    check_cloud,
    check_grid,
    csv,
    npy,
    npz,
    refused,
)


def test_files_are_read_for_a_box() -> None:
    values = on_box(np.linspace(10, 14, 41)[:, None], np.linspace(-2, -1, 21))
    stream = io.BytesIO()
    np.save(stream, values)
    field = read_samples(stream.getvalue(), "u.npy", box=BOX)
    assert isinstance(field, em.GridSamples)
    assert (field.x[0], field.x[-1], field.y[0], field.y[-1]) == (10, 14, -2, -1)
    csv = b"".join(b"%d,%d,1\n" % (x, y) for x in (10, 12, 14) for y in (-2, -1))
    assert isinstance(read_samples(csv, "u.csv", box=BOX), em.GridSamples)
    assert "unit square" in refusal(read_samples, csv, "u.csv").message
    assert set(read_arrays(csv, "u.csv")) == {"x", "y", "values"}  # the domain is not known yet


class TestArrays:
    def test_npz_grid_and_scattered(self) -> None:
        check_grid(read_samples(npz(x=X, y=Y, values=TABLE), "u.npz"))
        check_cloud(read_samples(npz(points=CLOUD, values=CLOUD_U, other=[1]), "U.NPZ"))

    def test_npz_in_other_layouts(self) -> None:
        stored = npz(x=X.astype(">f8"), y=Y, values=np.asfortranarray(TABLE))
        check_grid(read_samples(stored, "u.npz"))
        whole = read_samples(npz(x=np.arange(2), y=np.arange(2, dtype="u1"), values=np.ones((2, 2), "f2")), "u.npz")
        assert whole.values.dtype == np.float64

    def test_npz_without_the_keys(self) -> None:
        refused(npz(u=TABLE, y=Y), "u.npz", "'u', 'y'", "values (a grid)")
        refused(npz(x=X, y=Y), "u.npz", "'x', 'y'", "values (a grid)")
        refused(npz(x=X, y=Y, p=TABLE, T=TABLE), "u.npz", "more than one array can be u", "p, T")
        refused(npz(x=X), "u.npz", "'x'")

    def test_nothing_is_unpickled(self) -> None:

        evil = np.array([[None, {}]], dtype=object)
        refused(npz(x=X, y=Y, values=evil), "u.npz", "values holds data of type '|O'")
        refused(npy(evil), "u.npy", "values holds data of type '|O'")
        refused(pickle.dumps([1.0]), "u.npy", "not a plain npy array")

    def test_a_header_that_promises_more_than_there_is(self) -> None:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }"
        header += b" " * (117 - len(header)) + b"\n"
        data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 64
        refused(data, "u.npy", "64 bytes", "(1000000, 1000000)")
        negative = data.replace(b"(1000000, 1000000)", b"(-8, -1)          ")
        refused(negative, "u.npy", "not a plain npy array", "(-8, -1)")

    def test_npy_is_u_on_the_uniform_grid(self) -> None:
        check_grid(read_samples(npy(TABLE), "u.npy"), X, np.linspace(0, 1, 5), TABLE)
        refused(npy(TABLE.ravel()), "u.npy", "shape (30,)", "2-D", "npz")
        refused(npy(TABLE + 1j), "u.npy", "'<c16'")
        refused(npy(np.ones((1, 1))), "u.npy", "x has 1 point")
        refused(npy(np.where(TABLE[1, 3] == TABLE, np.nan, TABLE)), "u.npy", "values[1][3] is NaN")


class TestJson:
    @pytest.mark.parametrize("wrap", [lambda d: d, lambda d: {"grid": d}, lambda d: {"u": {"grid": d}}])
    def test_grid(self, wrap: Callable[[Any], Any]) -> None:
        body = {"x": X.tolist(), "y": Y.tolist(), "values": TABLE.tolist()}
        check_grid(read_samples(json.dumps(wrap(body)).encode(), "u.json"))

    def test_scattered(self) -> None:
        body = {"scattered": {"points": CLOUD.tolist(), "values": CLOUD_U.tolist()}}
        check_cloud(read_samples(json.dumps(body).encode(), "u.json"))

    @pytest.mark.parametrize(
        ("text", "word"),
        [
            ("{", "cannot be read"),
            ("[1, 2]", "must hold an object"),
            ('{"grid": 3}', "must hold an object"),
            ('{"x": [0, 1]}', "holds 'x'"),
            ('{"x": [0, 1], "y": [0, 1], "values": [[0, NaN], [0, 1]]}', "values[0][1] is NaN"),
            ('{"x": [0, 1], "y": [0, 1], "values": [[0, "a"], [0, 1]]}', "values[0][1] is the text"),
            ('{"x": null, "y": [0, 1], "values": [[0, 1], [0, 1]]}', "x"),
            ("[" * 200_000, "cannot be read"),
            ('{"x": [0, 1' + "0" * 5000 + '], "y": [0, 1], "values": [[0, 1], [0, 1]]}', ""),
            ("\xff", "cannot be read"),
        ],
    )
    def test_broken(self, text: str, word: str) -> None:
        refused(text.encode("latin-1"), "u.json", word)


class TestCsv:
    def test_rows_of_a_grid_in_any_order_make_a_grid(self) -> None:
        mixed = np.random.default_rng(1).permutation(len(GRID_POINTS))
        check_grid(read_samples(csv(GRID_POINTS[mixed], TABLE.ravel()[mixed]), "u.csv"))

    def test_other_rows_are_scattered(self) -> None:
        check_cloud(read_samples(csv(CLOUD, CLOUD_U), "u.csv"))
        holes = np.delete(np.arange(30), [8])
        assert isinstance(read_samples(csv(GRID_POINTS[holes], TABLE.ravel()[holes]), "u.csv"), ScatteredSamples)

    @pytest.mark.parametrize(
        "head", ["", "x,y,u\n", "# made by hand\n\nX, Y, u\n", "\ufeffx,y,value\r\n", '"x","y","T"\n']
    )
    def test_headers(self, head: str) -> None:
        check_cloud(read_samples(csv(CLOUD, CLOUD_U, head=head), "u.csv"))

    @pytest.mark.parametrize("separator", [",", ";", "\t", "  ", " ; "])
    @pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
    def test_separators_and_line_ends(self, separator: str, end: str) -> None:
        check_cloud(read_samples(csv(CLOUD, CLOUD_U, head="", separator=separator, end=end), "u.csv"))

    def test_a_repeated_row_and_a_missing_one_make_no_grid(self) -> None:
        rows = np.arange(30)
        rows[8] = 7
        assert isinstance(read_samples(csv(GRID_POINTS[rows], TABLE.ravel()[rows]), "u.csv"), ScatteredSamples)

    def test_the_header_gives_the_order_and_other_columns_are_ignored(self) -> None:
        rows = "\n".join(f"{u!r},7,{y!r},{x!r}" for (x, y), u in zip(CLOUD.tolist(), CLOUD_U.tolist(), strict=True))
        check_cloud(read_samples(("u,id,y,x\n" + rows).encode(), "u.csv"))

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("x,y,u\n0,0,1\n0,1,abc\n", ["line 3", "'abc'"]),
            ("0,0,1\n0,1\n", ["line 2", "2 columns"]),
            ("0,0,1\n0,1,nan\n", ["line 2", "not finite"]),
            ("nan,0,1\n0,1,1\n", ["line 1", "not finite"]),
            ("0;0;1\n0;0,5;1\n", ["line 2", "decimal mark"]),
            ("a,b,c\n0,0,1\n", ["line 1", "name the columns"]),
            ("x,y,p,q\n0,0,1,1\n", ["more than one column can be u", "p, q", "column=NAME"]),
            ("x,y,u\n", ["no line of samples"]),
            ("# only a comment\n", ["no line of samples"]),
            ("0.5,0.5,1\n", ["1 sample", "at least 4"]),
            ("0,0,1\n0,0,1\n1,1,1\n0,1,1\n1,0,1\n0,0,2\n", ["points[5] repeats points[1]"]),
            ("0,0,1\n0.9,0,1\n0,0.9,1\n0.9,0.9,1\n", ["from 0 to 0.9", "cover"]),
        ],
    )
    def test_broken(self, text: str, words: list[str]) -> None:
        refused(text.encode(), "u.csv", *words)

    def test_other_encodings_are_named(self) -> None:
        refused(csv(CLOUD, CLOUD_U).decode().encode("utf-16"), "u.csv", "UTF-8")


class TestColumns:
    """Files of other people: u is found by its name, or chosen."""

    def table(self, head: str, *more: Any, separator: str = ",") -> bytes:
        rows = np.column_stack([CLOUD, CLOUD_U, *more]).tolist()
        return (head + "\n".join(separator.join(map(repr, row)) for row in rows)).encode()

    def test_a_table_with_more_than_one_column_asks_which_is_u(self) -> None:
        data = self.table("x, y, T, p\n", CLOUD_U * 2)
        error = refusal(read_samples, data, "flow.csv")
        assert isinstance(error, SamplesError)
        assert error.columns == ("T", "p")
        assert pickle.loads(pickle.dumps(error)).columns == ("T", "p")
        for column in ("T", "t"):
            check_cloud(read_samples(data, "flow.csv", column=column))
        other = read_samples(data, "flow.csv", column="p")
        assert isinstance(other, ScatteredSamples)
        np.testing.assert_array_equal(other.values, CLOUD_U * 2)
        refused(data, "flow.csv", "there is no column 'q'", "T, p", column="q")
        refused(data, "flow.csv", "there is no column 'x'", column="x")

    def test_coordinates_of_paraview(self) -> None:
        head = '"Points:0","Points:1","temperature","Points:2"\n'
        check_cloud(read_samples(self.table(head, np.zeros(len(CLOUD))), "points.csv"))
        check_cloud(read_samples(self.table("Points_0,Points_1,T,p\n", CLOUD_U * 2), "points.csv", column="T"))
        refused(self.table("x,y,T,z\n", CLOUD_U * 2), "points.csv", "T, z")

    def test_a_table_without_a_header_drops_no_column(self) -> None:
        data = self.table("", CLOUD_U * 2)
        error = refusal(read_samples, data, "u.csv")
        assert isinstance(error, SamplesError)
        assert error.columns == ("3", "4", "matrix")
        check_cloud(read_samples(data, "u.csv", column="3"))
        refused(data, "u.csv", "'2' is no number", column="2")
        refused(data, "u.csv", "'5' is no number", column="5")
        refused(data, "u.csv", "'T' is no number", column="T")

    def test_a_matrix_is_taken_by_choice(self) -> None:
        rows = [" ".join(map(repr, row)) for row in np.outer(np.arange(64.0), np.ones(64)).tolist()]
        data = "\n".join(rows).encode()
        assert "may be a matrix of values" in refused(data, "u.csv").message
        found = read_samples(data, "u.csv", column="matrix")
        assert isinstance(found, GridSamples)
        assert found.values[:, 5].tolist() == list(range(64))
        np.testing.assert_array_equal(found.x, np.linspace(0, 1, 64))
        refused(data + b" 1", "u.csv", "line 64 of the csv file has 65 values, the first 64", column="matrix")
        refused(data + b"\n" + b"nan " * 64, "u.csv", "line 65", "not finite", column="matrix")
        refused(data, "u.csv", "more than 4000 samples", column="matrix", max_samples=4000)
        refused(b"1 " * 1001, "u.csv", "more than 1000 columns", column="matrix")

    def test_text_with_blanks(self) -> None:
        check_cloud(read_samples(self.table("", separator="   "), "u.txt"))
        check_cloud(read_samples(self.table("x y T p\n", CLOUD_U, separator=" "), "u.TXT", column="T"))

    def test_npz_with_u(self) -> None:
        check_grid(read_samples(npz(x=X, y=Y, u=TABLE), "u.npz"))
        check_grid(read_samples(npz(x=X, y=Y, p=TABLE, T=TABLE * 2), "u.npz", column="p"))
        check_grid(read_samples(npz(x=X, y=Y, values=TABLE, T=TABLE * 2), "u.npz"))
        check_cloud(read_samples(npz(x=CLOUD[:, 0], y=CLOUD[:, 1], u=CLOUD_U), "u.npz"))
        check_cloud(read_samples(npz(points=CLOUD, T=CLOUD_U), "u.npz"))
        along = [array.ravel() for array in np.meshgrid(X, Y, indexing="ij")]
        check_grid(read_samples(npz(x=along[0], y=along[1], u=TABLE.ravel()), "u.npz"))

    def test_both_orders_of_meshgrid(self) -> None:
        first = read_samples(npz(**dict(zip("xyu", (*np.meshgrid(X, Y, indexing="ij"), TABLE), strict=True))), "u.npz")
        other = read_samples(npz(**dict(zip("xyu", (*np.meshgrid(X, Y), TABLE.T), strict=True))), "u.npz")
        for field in (first, other):
            assert isinstance(field, NodalField)
            np.testing.assert_array_equal(field.values, TABLE)

    def test_json_with_u(self) -> None:
        body = json.dumps({"x": X.tolist(), "y": Y.tolist(), "u": TABLE.tolist(), "note": 3})
        check_grid(read_samples(body.encode(), "u.json"))

    def test_npy_has_no_columns(self) -> None:
        refused(npy(TABLE), "u.npy", "leave the column out", column="u")

    def test_names_that_cannot_be_printed(self) -> None:
        refused(json.dumps({"x": [0], "y": [0], "a\ud800": [1], "b": [2]}).encode(), "u.json", "\\ud800")


def test_unknown_and_empty_files() -> None:
    refused(b"1", "u.xlsx", "'u.xlsx'", "npz, npy, csv, txt, json, vtu, vtk")
    refused(b"1", "noname", "suffix")
    for name in ("u.xdmf", "u.XDMF", "u.zip"):
        refused(b"1", name, name, "samples in XDMF are not read", "as vtu, npz or csv")
    for suffix in READERS:
        refused(b"", f"u.{suffix}", "is empty")
        refused(b" \n", f"u.{suffix}", "is empty")
    refused(b"0,0,1\n" * 10, "u.csv", "60 bytes", "50 allowed", max_bytes=50)
    assert MAX_BYTES == 256 * 2**20


@pytest.mark.parametrize(
    "text", [b"[" * 4_000_000, b'{"values":[' + b"9" * 4_000_000 + b"]}"], ids=["deep", "a long number"]
)
def test_a_bomb_of_json_is_refused(text: bytes) -> None:
    check_bomb_is_refused(text, "u.json", "cannot be read")


@pytest.mark.parametrize("text", ["a text", b"bytes"])
def test_one_array_of_an_npz_file_may_be_a_text(text: str | bytes) -> None:
    stream = io.BytesIO()
    np.savez(stream, settings=text, values=np.ones((2, 3)))
    found = read_npz(stream.getvalue(), text="settings")
    assert (found["settings"].item(), found["values"].shape) == (text, (2, 3))
    assert "only real numbers" in refusal(read_npz, stream.getvalue()).message
    lists = io.BytesIO()
    np.savez(lists, settings=[text, text])
    assert "only real numbers" in refusal(read_npz, lists.getvalue(), text="settings").message
