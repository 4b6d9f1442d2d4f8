"""Files that cost more than they are worth are refused soon, and whatever a reader raises is one kind of error."""

from __future__ import annotations

import base64
import io
import json
import logging
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError, SamplesError
from equimesh.io.reading import bounds
from equimesh.io.reading.bounds import MAX_MESSAGE, floats, integers, line_of, open_zip, refusing
from equimesh.io.reading.read import read_bytes, read_description
from equimesh.io.reading.vtk import VtkXml
from equimesh.io.solver_files import gmsh_text, su2_text
from solver.io.reading.plain import small
from solver.io.reading.test_foam import files as poly_mesh_files
from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import refused

MEGABYTE = 1 << 20
MOST_SECONDS = 8.0
"""CPU time of a refusal. Most take less than one second; each of these files took minutes."""
LONG = "n" * 400_000


def binary_msh(version: str, nodes: bytes, elements: bytes) -> bytes:
    head = f"$MeshFormat\n{version} 1 8\n".encode() + struct.pack("<i", 1) + b"\n$EndMeshFormat\n"
    return head + b"$Nodes\n" + nodes + b"\n$EndNodes\n$Elements\n" + elements + b"\n$EndElements\n"


def packed(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def with_boundary(content: bytes) -> bytes:
    return packed({name: text.encode() for name, text in poly_mesh_files().items()} | {"boundary": content})


COSTLY: dict[str, tuple[str, Callable[[], bytes]]] = {
    "empty blocks of nodes": (
        "msh",
        lambda: binary_msh("4.1", struct.pack("<4Q", 10**15, 1, 1, 1) + bytes(6 * MEGABYTE), bytes(32)),
    ),
    "empty blocks of elements": (
        "msh",
        lambda: binary_msh("2.2", b"1\n" + bytes(28), b"9\n" + struct.pack("<3i", 3, 0, 2) * 500_000),
    ),
    "empty blocks as text": (
        "msh",
        lambda: (
            b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n999999 1 1 1\n"
            + b"0 1 0 0\n" * (MEGABYTE // 4)
            + b"$EndNodes\n$Elements\n0 0 0 0\n$EndElements\n"
        ),
    ),
    "types that change with each element": (
        "msh",
        lambda: (
            b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n999999\n"
            + b"1 1 1 1 1 1\n2 15 0 1\n" * 150_000
            + b"$EndElements\n"
        ),
    ),
    "many sections": ("msh", lambda: b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + b"$A\n\n$EndA\n" * MEGABYTE),
    "many keywords": ("su2", lambda: b"A=\n" * (4 * MEGABYTE)),
    "records of no length": ("p3d", lambda: bytes(12 * MEGABYTE)),
    "repetitions": ("p3d", lambda: b"4472 4472 19999998*0.5 19999998*x "),
    "many repetitions": ("p3d", lambda: b"2 2 " + b"1*1 " * (12 * MEGABYTE)),
    "one bad word at the end": ("p3d", lambda: b"2 2 " + b"1 " * (2 * MEGABYTE) + b"x"),
    "many words in a boundary": ("zip", lambda: with_boundary(b"1(a{b c;}" + b" d" * (8 * MEGABYTE) + b")")),
}


@pytest.mark.parametrize("name", COSTLY)
def test_a_file_that_declares_too_much_is_refused_soon(name: str) -> None:
    format, make = COSTLY[name]
    data = make()
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        read_bytes(data, format)
    assert time.process_time() - began < MOST_SECONDS
    assert len(caught.value.message) <= MAX_MESSAGE


DESCRIPTIONS: dict[str, tuple[str, Callable[[], str]]] = {
    "many words": ("blockMeshDict", lambda: "vertices (" + "a " * (2 * MEGABYTE) + ");"),
    "variables of variables": (
        "blockMeshDict",
        lambda: "v0 (a);" + "".join(f"v{k} ($v{k - 1});" for k in range(1, 5000)) + "vertices ($v4999);",
    ),
    "many keys": ("json", lambda: "{" + ",".join(f'"{k}":0' for k in range(2_000_000)) + "}"),
    "many lists": ("json", lambda: '{"vertices":' + "[" * 100_000),
}


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_description_that_declares_too_much_is_refused_soon(name: str, tmp_path: Path) -> None:
    format, make = DESCRIPTIONS[name]
    (tmp_path / "file").write_text(make())
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        read_description(tmp_path / "file", format)
    assert time.process_time() - began < MOST_SECONDS
    assert len(caught.value.message) <= MAX_MESSAGE


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_broken_member_of_any_packing_is_refused(method: int) -> None:
    data = bytearray(packed({name: text.encode() for name, text in poly_mesh_files().items()}, method))
    start = data.index(b"points") + 6
    data[start : start + 20] = bytes(20)
    with pytest.raises(InputError, match=r"zip file|polyMesh|no number|no integer"):
        read_bytes(bytes(data), "zip")


def gmsh_with(name: str) -> bytes:
    mesh = small()
    sides = dict(zip([name, *list(mesh.sides)[1:]], mesh.sides.values(), strict=True))
    zeros = np.zeros(len(mesh.cells), int)
    return gmsh_text(mesh.points, mesh.cells, sides, subdomain=zeros, point_data={}, cell_data={}).encode()


def su2_with(name: str) -> bytes:
    mesh = small()
    sides = dict(zip([name, *list(mesh.sides)[1:]], mesh.sides.values(), strict=True))
    return su2_text(mesh.points, mesh.cells, sides).encode("latin-1")


NAMED = {
    "msh, long": ("msh", gmsh_with(LONG)),
    "su2, long": ("su2", su2_with(LONG)),
    "su2, NUL": ("su2", su2_with("abc").replace(b"abc", b"a\0b")),
    "msh, bell": ("msh", gmsh_with("a\x07b")),
}


@pytest.mark.parametrize(("format", "data"), NAMED.values(), ids=NAMED)
def test_names_that_no_file_can_hold_are_refused(format: str, data: bytes) -> None:
    with pytest.raises(InputError) as caught:
        read_bytes(data, format)
    assert "a side has" in caught.value.message
    assert len(caught.value.message) < 300
    caught.value.message.encode()


@pytest.mark.parametrize("name", [LONG, "a\0b", "\ud800"], ids=["long", "NUL", "surrogate"])
@pytest.mark.parametrize("place", ["sides", "vertices", "curves", "blocks"])
def test_names_of_a_description_are_checked(name: str, place: str) -> None:
    corners = {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}
    block = {"corners": [*corners], "cells": [2, 2]}
    document = {"vertices": corners, "blocks": [block]}
    extra = {
        "sides": {"sides": {name: [["a", "b"]]}},
        "vertices": {"vertices": {**corners, name: [2, 2]}},
        "curves": {"curves": {name: {"kind": "line"}}},
        "blocks": {"blocks": [{**block, "name": name}]},
    }[place]
    with pytest.raises(InputError) as caught:
        Blocks.of(json.loads(json.dumps(document | extra)))
    assert " name " in caught.value.message
    assert len(caught.value.message) < 300
    (caught.value.message + caught.value.field).encode()


def test_what_a_reader_raises_is_one_error(caplog: pytest.LogCaptureFixture) -> None:
    for error in (
        RecursionError("deep"),
        OSError("bad"),
        EOFError(),
        KeyError("a"),
        MemoryError(),
        ZeroDivisionError(),
    ):
        with pytest.raises(InputError, match="the su2 file cannot be read"), refusing("su2"):
            raise error
    assert not caplog.records


def test_a_defect_of_a_reader_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR), pytest.raises(InputError, match="cannot be read"), refusing("su2"):
        raise AssertionError("ours")
    assert "the reader of su2 failed" in caplog.text


def test_messages_are_short_and_can_be_sent() -> None:
    with pytest.raises(InputError) as caught, refusing("su2"):
        raise InputError("a \ud800 \0 " + LONG, field="\ud800")
    assert len(caught.value.message) <= MAX_MESSAGE + 20
    (caught.value.message + caught.value.field).encode()
    assert caught.value.message.isprintable()


# Numbers of a text: to the last bit, and the line of a word that is none.


def test_numbers_are_read_to_the_last_bit() -> None:
    values = np.random.default_rng(1).standard_normal(200) * 10.0 ** np.arange(-100, 100)
    np.testing.assert_array_equal(floats("\n ".join(map(repr, values.tolist())).encode(), 1, "values"), values)
    assert integers(b" 3 -4\t5\n", 1, "values").tolist() == [3, -4, 5]
    assert floats(b" \n", 1, "values").size == 0


@pytest.mark.parametrize(
    ("text", "told"), [(b"1 2\n3 4x 5", "line 8: '4x' is no integer"), (b"1\n\n2.5", "line 9: '2.5'")]
)
def test_the_line_of_a_wrong_word(text: bytes, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        integers(text, 7, "the cells")
    assert "among the cells" in caught.value.message


def test_the_line_of_a_byte() -> None:
    assert [line_of(b"a\nb\n", k) for k in range(4)] == [1, 1, 2, 2]


def savez() -> bytes:
    """A file as NumPy writes it."""
    file = io.BytesIO()
    np.savez(file, x=np.arange(2.0), y=np.arange(3), values=np.ones((2, 3)))
    return file.getvalue()


def members(data: bytes, most: int = MEGABYTE) -> dict[str, bytes] | str:
    """The members of a zip file, or the words with which it is refused."""
    try:
        with open_zip(data, "npz", most, "write it again") as found:
            return {name: found.read(name) for name in found.names if found.size(name) >= 0}
    except InputError as error:
        return error.message


def damaged(data: bytes) -> dict[str, bytes]:
    """The file with one byte changed, in each place of its heads and lists and some of its data, and cut short."""
    heads = [place for place in range(len(data)) if not 200 < place % 330 < 300]
    flipped = {f"{place} ^ {bit}": _flipped(data, place, bit) for place in heads for bit in (1, 64)}
    cut = {f"to {end}": data[:end] for end in range(0, len(data), 37)}
    return {**flipped, **cut, "moved": b"#!" + data, "with more": data + b"\0", "twice": data + data}


def _flipped(data: bytes, place: int, bit: int) -> bytes:
    changed = bytearray(data)
    changed[place] ^= bit
    return bytes(changed)


def test_plain_files_are_read_as_zipfile_reads_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is wrong with a file: the same members, or the same words."""
    others = {"deflated": packed({"x.npy": bytes(900)}), "none": packed({}), "umlaut": packed({"\u00fc": b"1"}, 0)}
    files = {"savez": savez(), **others, **damaged(savez())}
    here = {name: members(data) for name, data in files.items()}
    assert bounds._Stored.of(files["savez"]) is not None
    monkeypatch.setattr(bounds._Stored, "of", lambda _: None)
    there = {name: members(data) for name, data in files.items()}
    assert {name: (here[name], there[name]) for name in files if here[name] != there[name]} == {}
    assert sum(isinstance(found, str) for found in here.values()) > 100


def test_plain_files_have_the_limits_of_others() -> None:
    data = savez()
    found = members(data)
    assert isinstance(found, dict)
    total = sum(map(len, found.values()))
    assert members(data, total) == found
    assert "more than the bytes allowed" in str(members(data, total - 1))


PACKED = base64.b64encode(struct.pack("<I3i", 12, 5, -6, 2**30)).decode()


def reader(array: str, limit: int = 1000) -> VtkXml:
    return VtkXml(f'<VTKFile byte_order="LittleEndian"><a>{array}</a></VTKFile>'.encode(), limit)


@pytest.mark.parametrize(
    "array",
    [
        f'<DataArray type="Int32" format="binary">{PACKED}</DataArray>',
        f'<DataArray type="Int64" format="ascii">5 -6 {2**30}</DataArray>',
    ],
)
def test_numbers_of_both_encodings(array: str) -> None:
    found = reader(array)
    np.testing.assert_array_equal(found.array(found.root[0][0], 3), [5, -6, 2**30])
    with pytest.raises(SamplesError, match=r"where 4 are expected|ends too early"):
        found.array(found.root[0][0], 4)


def test_more_than_the_limit_is_refused_before_it_is_read() -> None:
    found = reader('<DataArray type="Int64" Name="q" format="ascii">5</DataArray>', limit=7)
    with pytest.raises(SamplesError, match="more data than the limit allows"):
        found.array(found.root[0][0], 1)


def test_another_compressor_is_named() -> None:
    with pytest.raises(SamplesError, match="compressed by vtkLZ4"):
        VtkXml(b'<VTKFile compressor="vtkLZ4"></VTKFile>', 10)


def test_more_blocks_than_bytes_are_refused() -> None:
    packed = base64.b64encode(struct.pack("<1003I", 1000, 1, 0, *[0] * 1000)).decode()
    array = f'<DataArray type="Int32" Name="q" format="binary">{packed}</DataArray>'
    file = f'<VTKFile compressor="vtkZLibDataCompressor" byte_order="LittleEndian"><a>{array}</a></VTKFile>'
    found = VtkXml(file.encode(), 1000)
    with pytest.raises(SamplesError, match="has 1000 blocks for 12 bytes: save larger blocks"):
        found.array(found.root[0][0], 3)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused_in_any_encoding(encoding: str) -> None:
    head = f"<?xml version='1.0' encoding='{encoding}'?>"
    laughs = f'{head}<!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile>&b;</VTKFile>'
    refused(laughs.encode(encoding), "u.vtu", "entities")


# Made when they are needed: each process of tests collects all files.
BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "deep": (lambda: b"<VTKFile>" + b"<a>" * 1_000_000 + b"</a>" * 1_000_000 + b"</VTKFile>", "more than 100000"),
    "not quite as deep": (lambda: b"<VTKFile>" + b"<a>" * 40_000 + b"</a>" * 40_000 + b"</VTKFile>", "levels deep"),
    "wide": (lambda: b"<VTKFile>" + b"<a/>" * 1_000_000 + b"</VTKFile>", "more than 100000 elements"),
    "many attributes": (lambda: b"<VTKFile " + b"".join(b"a%d='' " % k for k in range(500_000)) + b"/>", "attributes"),
    "entities": (lambda: b'<!DOCTYPE a [<!ENTITY b "c">]><VTKFile>&b;</VTKFile>', "or entities: save it again"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused(name: str) -> None:
    data, match = BOMBS[name]
    check_bomb_is_refused(data(), "u.vtu", match)
