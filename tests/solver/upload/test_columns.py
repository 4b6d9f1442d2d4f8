"""Which column is u: by its name, by the choice of the sender, or a refusal that lists them."""

from __future__ import annotations

import io
import json
import tracemalloc
from typing import Any

import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.upload import samples
from equimesh.upload.columns import MAX_OTHER_LINES, MAX_SECTIONS, Limits, choose, header_columns, numbered_columns
from equimesh.upload.samples import read_arrays


@pytest.mark.parametrize(
    ("names", "column", "found"),
    [
        ("x y u", None, (0, 1, 2)),
        ("u id Y X", None, (3, 2, 0)),
        ("x y z", None, (0, 1, 2)),
        ("x y T", None, (0, 1, 2)),
        ("x y T p", "p", (0, 1, 3)),
        ("x y T t", "t", (0, 1, 3)),
        ("x y T p", "P", (0, 1, 3)),
        ("Points:0 Points:1 Points:2 temperature", None, (0, 1, 3)),
        ("Points:0 Points:1 Points:2 T p", "Points:2", (0, 1, 2)),
        ("CoordX CoordY T", None, (0, 1, 2)),
        ("a b c", None, None),
        ("x T", None, None),
    ],
)
def test_the_columns_of_a_header(names: str, column: str | None, found: tuple[int, int, int] | None) -> None:
    assert header_columns(names.split(), column) == found


@pytest.mark.parametrize(
    ("names", "column", "columns"),
    [
        ("x y T p", None, ("T", "p")),
        ("x y z T", None, ("z", "T")),
        ("Points:0 Points:1 Points:2 T p", None, ("T", "p")),
        ("x y T p", "x", ("T", "p")),
        ("x y T T", "T", ("T", "T")),
        ("x y u", "T", ("u",)),
    ],
)
def test_a_refusal_lists_the_columns(names: str, column: str | None, columns: tuple[str, ...]) -> None:
    with pytest.raises(SamplesError, match="column=NAME") as caught:
        header_columns(names.split(), column)
    assert caught.value.columns == columns
    assert all(name in caught.value.message for name in columns)


def test_a_file_with_places_alone_needs_values() -> None:
    with pytest.raises(SamplesError, match="add one with the values of u") as caught:
        header_columns(["x", "y"], None)
    assert caught.value.columns == ()


def test_columns_without_a_header_have_numbers() -> None:
    assert numbered_columns(3, None) == numbered_columns(5, "3") == (0, 1, 2)
    assert numbered_columns(5, "5") == (0, 1, 4)
    for width, column in ((5, "6"), (5, "2"), (5, "T"), (2, "3"), (4, "9" * 5000), (4, "²")):
        with pytest.raises(SamplesError, match="no number of a column"):
            numbered_columns(width, column)


def test_lists_and_names_are_short() -> None:
    with pytest.raises(SamplesError) as caught:
        numbered_columns(1000, None)
    assert caught.value.columns[-1] == "matrix"
    assert len(caught.value.columns) <= 51
    with pytest.raises(SamplesError) as caught:
        choose([f"{k}{'n' * 10_000}\n\x00" for k in range(1000)], None, ("x", "y"), "array")
    assert len(caught.value.message) < 2000
    assert len(caught.value.columns) <= 51
    assert caught.value.message.isprintable()


# Reading stops at the limit of samples: before anything is read of a file that states more, else after so many.


MOST = 1000
REFUSED = f"the file has more than {MOST} samples, the limit: send fewer"
POINTS = np.random.default_rng(1).random((10 * MOST, 2))


class Counted(io.BytesIO):
    """Bytes of which it is known how many were read."""

    count = 0

    def read1(self, size: int | None = -1, /) -> bytes:
        found = super().read1(-1 if size is None else size)
        Counted.count += len(found)
        return found


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> type[Counted]:
    monkeypatch.setattr(samples.io, "BytesIO", Counted)
    Counted.count = 0
    return Counted


def refused(data: bytes, name: str) -> None:
    with pytest.raises(SamplesError) as caught:
        read_arrays(data, name, max_samples=MOST)
    assert str(caught.value) == REFUSED


def test_a_csv_is_read_up_to_the_limit(counted: type[Counted]) -> None:
    row = b"0.123,0.456,0.789\n"
    refused(b"x,y,u\n" + 10_000 * MOST * row, "u.csv")
    assert 0 < counted.count <= MOST * len(row) + 2 * io.DEFAULT_BUFFER_SIZE
    assert len(read_arrays(b"x,y,u\n" + MOST * row, "u.csv", max_samples=MOST)["values"]) == MOST


@pytest.mark.parametrize("line", [b"\n", b"# nothing\n", b"\r"])
def test_lines_without_samples_are_limited_too(counted: type[Counted], line: bytes) -> None:
    refused((100 * MAX_OTHER_LINES) * line + b"0,0,1\n", "u.csv")
    assert 0 < counted.count <= (2 * MOST + MAX_OTHER_LINES) * len(line) + 2 * io.DEFAULT_BUFFER_SIZE
    assert read_arrays(MOST * (line + b"0,0,1\n"), "u.csv", max_samples=MOST)["values"].shape == (MOST,)


def test_a_line_of_a_csv_has_an_end() -> None:
    with pytest.raises(SamplesError, match="line 1 of the csv file has more than 1000 columns"):
        read_arrays(1_000_000 * b"1,", "u.csv")


def test_a_json_is_not_parsed_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    body: dict[str, Any] = {"points": POINTS[: MOST + 1].tolist(), "values": [0.0] * (MOST + 1)}
    refused(json.dumps({"scattered": body}).encode(), "u.json")
    body = {"points": POINTS[:MOST].tolist(), "values": [0.0] * MOST}
    assert read_arrays(json.dumps({"scattered": body}).encode(), "u.json", max_samples=MOST) == body
    grid = {"x": list(range(50)), "y": list(range(50)), "values": [[0.0] * 50] * 50}
    refused(json.dumps({"grid": grid}).encode(), "u.json")
    monkeypatch.setattr(json, "loads", lambda _: pytest.fail("it was parsed"))
    refused(b'{"values": [' + b"0," * (4 * MOST + 10_000) + b"0]}", "u.json")


@pytest.mark.parametrize("dtype", ["f8", "i1"])
def test_an_npz_is_not_unpacked_beyond_the_limit(monkeypatch: pytest.MonkeyPatch, dtype: str) -> None:
    def packed(number: int) -> bytes:
        stream = io.BytesIO()
        np.savez_compressed(stream, points=POINTS[:number], values=np.zeros(number, dtype))
        return stream.getvalue()

    assert len(read_arrays(packed(MOST), "u.npz", max_samples=MOST)["values"]) == MOST
    refused(packed(MOST + 1), "u.npz")
    monkeypatch.setattr(samples, "_parse_npy", lambda *_: pytest.fail("it was unpacked"))
    refused(packed(10 * MOST), "u.npz")


def test_an_npy_is_refused() -> None:
    stream = io.BytesIO()
    np.save(stream, np.zeros((101, 10)))
    refused(stream.getvalue(), "u.npy")


VTU = """<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"><UnstructuredGrid>
{}</UnstructuredGrid></VTKFile>"""
PIECE = '<Piece NumberOfPoints="{}"><Points><DataArray type="Float64" format="ascii">{}</DataArray></Points></Piece>'
LEGACY = "# vtk DataFile Version 3.0\nu\nASCII\nDATASET UNSTRUCTURED_GRID\n"


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (VTU.format(PIECE.format(MOST + 1, "")), "u.vtu"),
        (VTU.format(PIECE.format(MOST // 2, "0 " * (3 * (MOST // 2))) + PIECE.format(MOST // 2 + 1, "")), "u.vtu"),
        (LEGACY + f"POINTS {MOST + 1} double\n", "u.vtk"),
        (LEGACY + f"POINTS 1 double\n0 0 0\nPOINT_DATA {MOST + 1}\nSCALARS u double\nLOOKUP_TABLE default\n", "u.vtk"),
    ],
)
def test_a_file_that_states_more_is_not_read(text: str, name: str) -> None:
    """Its numbers are not there: where they were looked for, the message would say so."""
    refused(text.encode(), name)


def test_numbers_beyond_those_stated_are_not_split() -> None:
    numbers = "0.5 " * 400_000
    data = VTU.format(PIECE.format(1, numbers)).encode()
    tracemalloc.start()
    with pytest.raises(SamplesError, match="cannot be read"):
        read_arrays(data, "u.vtu")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 12e6  # a text for each number would take 20 MB more


def test_a_legacy_file_has_few_sections_and_any_number_of_blank_lines() -> None:
    body = "POINTS 4 double\n0 0 0 1 0 0 0 1 0\n\n1 1 0\nMETADATA\nINFORMATION 0\n \nPOINT_DATA 4\nSCALARS u double\n"
    text = LEGACY + 100_000 * " \n" + body + "LOOKUP_TABLE default\n1 2\n" + 100_000 * "\n" + "3 4\n"
    assert read_arrays(text.encode(), "u.vtk")["values"].tolist() == [[1.0, 3.0], [2.0, 4.0]]
    with pytest.raises(SamplesError, match=f"more than {MAX_SECTIONS} sections"):
        read_arrays((LEGACY + 100_000 * "POINTS 0 double\n").encode(), "u.vtk")
    fields = "FIELD FieldData 100000\n" + 100_000 * "a 1 0 double\n"
    with pytest.raises(SamplesError, match=f"more than {MAX_SECTIONS} sections"):
        read_arrays((LEGACY + "POINTS 0 double\nPOINT_DATA 0\n" + fields).encode(), "u.vtk")


def test_limits_follow_the_number_of_samples() -> None:
    limits = Limits(max_bytes=1, max_samples=10)
    limits.check(10)
    limits.check(11, 11)
    for number, most in ((11, None), (12, 11)):
        with pytest.raises(SamplesError, match="more than 10 samples"):
            limits.check(number, most)
    assert (limits.max_lines, limits.max_values, limits.max_npy_bytes) == (10_020, 10_040, 65_696)
