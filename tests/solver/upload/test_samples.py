"""Uploaded samples: every file type in every spelling people send, and hostile or broken files."""

from __future__ import annotations

import base64
import io
import json
import lzma
import pickle
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.io.write import Cells, MeshData, write_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.upload.samples import MAX_BYTES, READERS, read_samples

X, Y = np.linspace(0, 1, 6), np.array([0.0, 0.1, 0.4, 0.7, 1.0])
TABLE = np.sin(3 * X)[:, None] + Y**2
GRID_POINTS = np.column_stack([a.ravel() for a in np.meshgrid(X, Y, indexing="ij")])
CLOUD = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], np.random.default_rng(2).random((40, 2))])
CLOUD_U = CLOUD[:, 0] - 2 * CLOUD[:, 1]


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def csv(points: Any, u: Any, *, head: str = "x,y,u\n", separator: str = ",", end: str = "\n") -> bytes:
    rows = (separator.join(map(repr, map(float, (*p, v)))) for p, v in zip(points, np.ravel(u), strict=True))
    return (head + end.join(rows) + end).encode()


def refused(data: bytes, name: str, *words: str, **options: Any) -> SamplesError:
    with pytest.raises(SamplesError) as caught:
        read_samples(data, name, **options)
    for word in words:
        assert word in caught.value.message
    return caught.value


def check_grid(samples: Any, x: Any = X, y: Any = Y, table: Any = TABLE) -> None:
    assert isinstance(samples, GridSamples)
    for found, expected in ((samples.x, x), (samples.y, y), (samples.values, table)):
        np.testing.assert_array_equal(found, expected)


def check_cloud(samples: Any) -> None:
    assert isinstance(samples, ScatteredSamples)
    np.testing.assert_array_equal(samples.points, CLOUD)
    np.testing.assert_array_equal(samples.values, CLOUD_U)


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
        refused(npz(x=X, y=Y, u=TABLE), "u.npz", "'u', 'x', 'y'", "values (a grid)")
        refused(npz(x=X), "u.npz", "'x'")

    def test_npz_that_is_none(self) -> None:
        refused(b"PK nonsense", "u.npz", "cannot be unpacked", "numpy.savez")
        refused(npz(x=X, y=Y, values=TABLE)[:-40], "u.npz", "cannot be unpacked")
        refused(npy(TABLE), "u.npz", "cannot be unpacked")

    def test_npz_with_damaged_contents(self) -> None:
        data = bytearray(npz(x=X, y=Y, values=TABLE))
        at = data.index(b"values.npy") + 60
        data[at] ^= 0xFF
        refused(bytes(data), "u.npz")

    def test_nothing_is_unpickled(self) -> None:

        evil = np.array([[None, {}]], dtype=object)
        refused(npz(x=X, y=Y, values=evil), "u.npz", "values holds data of type '|O'")
        refused(npy(evil), "u.npy", "values holds data of type '|O'")
        refused(pickle.dumps([1.0]), "u.npy", "not a plain npy array")

    def test_a_zip_bomb_is_not_unpacked(self) -> None:
        bomb = npz(x=X, y=Y, values=np.zeros(4_000_000))
        assert len(bomb) < 100_000
        refused(bomb, "u.npz", "unpacks to more than", max_bytes=1_000_000)

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
            ("x,y,p,q\n0,0,1,1\n", ["line 1", "name the columns"]),
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


def mesh_file(folder: Path, form: str, points: Any, data: dict[str, Any], **options: Any) -> bytes:
    path = folder / "u.mesh"
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("vertex", [[0], [1]])], point_data=data)
    meshio.write(path, mesh, file_format=form, **options)
    return path.read_bytes()


VTK_HEAD = "# vtk DataFile Version 3.0\ntitle POINTS 3 float\nASCII\nDATASET UNSTRUCTURED_GRID\n"


def vtu(arrays: dict[str, Any], *, tail: str = "", **attributes: str) -> bytes:
    """A vtu file around the given texts of its arrays: ``(attributes, text)`` each."""
    root = "".join(f' {k}="{v}"' for k, v in attributes.items())
    parts = {
        name: f"<DataArray type='Float64' Name='{name}' {form}>{text}</DataArray>"
        for name, (form, text) in arrays.items()
    }
    return (
        f"<?xml version='1.0'?><VTKFile type='UnstructuredGrid' version='1.0'{root}><UnstructuredGrid>"
        f"<Piece NumberOfPoints='{len(CLOUD)}' NumberOfCells='0'><PointData>{parts['u']}</PointData>"
        f"<Points>{parts['Points']}</Points></Piece></UnstructuredGrid>{tail}</VTKFile>"
    ).encode("latin-1")


RAW = {"u": CLOUD_U.tobytes(), "Points": np.pad(CLOUD, ((0, 0), (0, 1))).tobytes()}


def compressed(data: bytes, pack: Callable[[bytes], bytes], *, declared: int | None = None) -> tuple[bytes, bytes]:
    """Header and blocks as VTK writes them, in blocks of 100 bytes."""
    blocks = [pack(data[k : k + 100]) for k in range(0, len(data), 100)]
    sizes = [len(block) for block in blocks]
    header = struct.pack(f"<{3 + len(sizes)}Q", declared or len(sizes), 100, len(data) % 100, *sizes)
    return header, b"".join(blocks)


class TestVtk:
    @pytest.mark.parametrize(
        ("form", "options"),
        [
            ("vtu", {}),
            ("vtu", {"compression": "lzma"}),
            ("vtu", {"compression": None}),
            ("vtu", {"header_type": "UInt64"}),
            ("vtk42", {}),
            ("vtk", {}),
        ],
    )
    def test_files_of_another_writer(self, tmp_path: Path, form: str, options: dict[str, Any]) -> None:
        suffix = form.rstrip("42")
        data = mesh_file(tmp_path, form, CLOUD, {"u": CLOUD_U, "other": CLOUD_U * 2}, **options)
        check_cloud(read_samples(data, f"u.{suffix}"))
        alone = mesh_file(tmp_path, form, CLOUD, {"T": CLOUD_U, "velocity": np.ones((len(CLOUD), 3))}, **options)
        check_cloud(read_samples(alone, f"u.{suffix}"))
        grid = mesh_file(tmp_path, form, GRID_POINTS, {"u": TABLE.ravel()}, **options)
        check_grid(read_samples(grid, f"u.{suffix}"))
        refused(
            mesh_file(tmp_path, form, CLOUD, {"p": CLOUD_U, "q": CLOUD_U}, **options), f"u.{suffix}", "it has: p, q"
        )
        refused(mesh_file(tmp_path, form, CLOUD, {}, **options), f"u.{suffix}", "it has: none")
        for end in (len(data) // 3, len(data) // 2, len(data) - len(data) // 5):
            refused(data[:end], f"u.{suffix}")

    def test_ascii_vtu(self) -> None:
        text = {name: ("format='ascii'", " ".join(map(repr, np.frombuffer(b).tolist()))) for name, b in RAW.items()}
        check_cloud(read_samples(vtu(text), "u.vtu"))
        refused(vtu(text | {"u": ("", "0.1 abc")}), "u.vtu", "cannot be read", "abc")
        refused(vtu(text | {"u": ("", "0.1 0.2")}), "u.vtu", "'u'", "2 numbers where 44 are expected")

    @pytest.mark.parametrize("encoding", ["raw", "base64"])
    @pytest.mark.parametrize("packing", [None, "zlib", "lzma"])
    def test_appended_data_as_paraview_writes_it(self, encoding: str, packing: str | None) -> None:
        pack = {"zlib": zlib.compress, "lzma": lzma.compress, None: bytes}[packing]
        appended, offsets = b"", {}
        for name, data in RAW.items():
            offsets[name] = len(appended)
            parts = (struct.pack("<Q", len(data)) + data,) if packing is None else compressed(data, pack)
            appended += b"".join(parts if encoding == "raw" else map(base64.b64encode, parts))
        arrays = {name: (f"format='appended' offset='{at}'", "") for name, at in offsets.items()}
        tail = f"<AppendedData encoding='{encoding}'>\n _{appended.decode('latin-1')}\n</AppendedData>"
        names = {"zlib": "vtkZLibDataCompressor", "lzma": "vtkLZMADataCompressor"}
        options = {"compressor": names[packing]} if packing else {}
        check_cloud(
            read_samples(vtu(arrays, tail=tail, header_type="UInt64", byte_order="LittleEndian", **options), "u.vtu")
        )

    @pytest.mark.parametrize("pack", [zlib.compress, lzma.compress])
    def test_a_compressed_bomb_is_not_expanded(self, pack: Callable[[bytes], bytes]) -> None:
        name = "vtkZLibDataCompressor" if pack is zlib.compress else "vtkLZMADataCompressor"
        block = pack(bytes(50_000_000))
        header = struct.pack("<4Q", 1, 50_000_000, 0, len(block))
        text = (base64.b64encode(header) + base64.b64encode(block)).decode()
        bomb = vtu(dict.fromkeys(RAW, ("format='binary'", text)), header_type="UInt64", compressor=name)
        tracemalloc.start()
        try:
            refused(bomb, "u.vtu", "does not expand to the 1056 bytes expected")
            assert tracemalloc.get_traced_memory()[1] < 20_000_000  # LZMA has a dictionary of 8 MB
        finally:
            tracemalloc.stop()

    def test_headers_that_promise_too_much(self) -> None:
        text = dict.fromkeys(RAW, ("format='ascii'", "1"))
        many = vtu(text).replace(b"NumberOfPoints='44'", b"NumberOfPoints='99999999999'")
        refused(many, "u.vtu", "more data than the limit allows")
        huge = base64.b64encode(struct.pack("<4Q", 2**62, 1, 1, 1)).decode()
        broken = vtu(
            dict.fromkeys(RAW, ("format='binary'", huge)), header_type="UInt64", compressor="vtkZLibDataCompressor"
        )
        refused(broken, "u.vtu", "ends too early")
        head = VTK_HEAD.encode()
        refused(head + b"POINTS 99999999999 double\n0 0 0\n", "u.vtk", "ends before")
        refused(head.replace(b"ASCII", b"BINARY") + b"POINTS 99999999999 double\n0 0 0\n", "u.vtk", "ends before")
        refused(head + b"POINTS -5 double\n0 0 0\n", "u.vtk", "ends before")

    def test_entities_are_refused(self) -> None:
        laughs = b'<!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile>&b;</VTKFile>'
        refused(laughs, "u.vtu", "entities")

    @pytest.mark.parametrize(
        "text",
        ["<a/>", "<VTKFile/>", "not xml", "<VTKFile compressor='vtkLZ4DataCompressor'/>", "<VTKFile header_type='X'/>"],
    )
    def test_other_xml(self, text: str) -> None:
        refused(text.encode(), "u.vtu", "vtu file")

    def test_ascii_vtk_with_every_section(self) -> None:
        points = "\n".join(f"{x!r} {y!r} 0" for x, y in CLOUD.tolist())
        values = " ".join(map(repr, CLOUD_U.tolist()))
        zeros = " ".join(["0"] * 44)
        text = (
            f"{VTK_HEAD}POINTS 44 double\n{points}\nMETADATA\nINFORMATION 0\n\nCELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\n"
            f"CELL_DATA 1\nSCALARS u float\nLOOKUP_TABLE default\n5\n"
            f"POINT_DATA 44\nVECTORS v float\n{zeros}\n{zeros} {zeros}\n"
            f"SCALARS u double 1\nLOOKUP_TABLE default\n{values}\n"
            f"LOOKUP_TABLE t 1\n0 0 0 1\nFIELD FieldData 1\nw 1 44 float\n{zeros}\n"
            f"TEXTURE_COORDINATES t 2 float\n{zeros} {zeros}\n"
        )
        check_cloud(read_samples(text.encode(), "u.vtk"))
        check_cloud(read_samples(text.replace("\n", "\r\n").encode(), "u.vtk"))

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("solid\n", ["# vtk DataFile"]),
            ("# vtk DataFile Version 3.0\nt\nXML\n", ["'XML'", "ASCII or BINARY"]),
            (VTK_HEAD, ["no POINTS"]),
            (VTK_HEAD + "POINTS 1 quadruple\n0 0 0\n", ["cannot be read", "quadruple"]),
            (VTK_HEAD + "POINTS\n", ["cannot be read"]),
            (VTK_HEAD + "POINTS 1 float\n0 0 0 7\n", ["4 numbers where 3"]),
            (VTK_HEAD + "POINTS 1 float\n0 zero 0\n", ["cannot be read", "zero"]),
            (VTK_HEAD + "ORIGIN 0 0 0\n", ["ORIGIN", "unstructured grid"]),
            (
                VTK_HEAD + "POINTS 1 float\n0 0 0\nPOINT_DATA 2\nSCALARS u float\nLOOKUP_TABLE d\n1 2\n",
                ["'u' has 2 values for 1 points"],
            ),
        ],
    )
    def test_broken_vtk(self, text: str, words: list[str]) -> None:
        refused(text.encode(), "u.vtk", *words)


XDMF = "<Xdmf><Domain><Grid><Geometry GeometryType='XY'>{points}</Geometry>{more}</Grid></Domain></Xdmf>"


def item(reference: str, dimensions: str, form: str = "HDF") -> str:
    return f"<DataItem Dimensions='{dimensions}' Format='{form}'>{reference}</DataItem>"


def xdmf(points: str, u: str) -> bytes:
    return XDMF.format(points=points, more=f"<Attribute Name='u' Center='Node'>{u}</Attribute>").encode()


def zipped(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            archive.writestr(name.replace("_", "."), data)
    return stream.getvalue()


def h5(fill: Callable[[h5py.File], Any]) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        fill(file)
    return stream.getvalue()


def with_cloud(file: h5py.File, **options: Any) -> None:
    group = file.create_group("g")
    group.create_dataset("points", data=CLOUD, **options)
    group.create_dataset("u", data=CLOUD_U, **options)


IN_H5 = xdmf(item("a.h5:/g/points", "44 2"), item(" a.h5:/g/u\n", "44"))


class TestXdmf:
    @pytest.mark.parametrize("cells", ["quad", "triangle"])
    def test_what_we_write(self, tmp_path: Path, cells: Cells) -> None:
        x, y = np.meshgrid(X, Y, indexing="ij")
        per_cell = np.ones((len(X) - 1, len(Y) - 1))
        data = MeshData(mesh=Mesh(x, y), u=TABLE, q_eq=per_cell, subdomain=per_cell.astype(np.int64))
        (path,) = write_mesh(tmp_path / "mesh.xdmf.zip", data, cells=cells)
        check_grid(read_samples(path.read_bytes(), path.name))
        check_grid(read_samples(path.read_bytes(), "u.xdmf"))

    def test_numbers_as_text(self) -> None:
        texts = [" ".join(map(repr, a.ravel().tolist())) for a in (CLOUD, CLOUD_U)]
        points, u = item(texts[0], "44 2", "XML"), item(texts[1], "44", "XML")
        check_cloud(read_samples(xdmf(points, u), "u.xdmf"))
        refused(xdmf(points, item("1 b", "2", "XML")), "u.xdmf", "'u'", "'b'")
        refused(xdmf(points, item("1 2", "2", "XML")), "u.xdmf", "2 values for 44 points")
        refused(xdmf(points, item("1 2", "44", "XML")), "u.xdmf", "2 numbers where 44")

    @pytest.mark.parametrize("options", [{}, {"compression": "gzip"}, {"compression": "gzip", "shuffle": True}])
    def test_arrays_of_an_h5_file(self, options: dict[str, Any]) -> None:
        check_cloud(read_samples(zipped(a_xdmf=IN_H5, a_h5=h5(lambda file: with_cloud(file, **options))), "u.zip"))

    @pytest.mark.parametrize("name", ["/etc/passwd", "../a.h5", "b.h5", "", "http://localhost/a.h5"])
    def test_only_members_are_read(self, name: str) -> None:
        asked = xdmf(item(f"{name}:/g/points", "44 2"), item("a.h5:/g/u", "44"))
        refused(zipped(a_xdmf=asked, a_h5=h5(with_cloud)), "u.zip", "no member of the zip file")
        refused(asked, "u.xdmf", "refers to", "send the zip")

    def test_arrays_elsewhere_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "secret.h5").write_bytes(h5(with_cloud))

        def linked(file: h5py.File) -> None:
            file["g"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/g")

        def outside(file: h5py.File) -> None:
            file.create_dataset("g/points", (44, 2), "f8", external=[(str(tmp_path / "secret.h5"), 0, 704)])

        def virtual(file: h5py.File) -> None:
            layout = h5py.VirtualLayout((44, 2), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "g/points", (44, 2))
            file.create_virtual_dataset("g/points", layout)

        for fill, words in ((linked, "no array"), (outside, "another file"), (virtual, "another file")):
            refused(zipped(a_xdmf=IN_H5, a_h5=h5(fill)), "u.zip", words)

    def test_bombs(self) -> None:
        tracemalloc.start()
        try:
            zeros = h5(lambda file: file.create_dataset("g/points", (10**7, 2), "f8", compression="gzip"))
            big = xdmf(item("a.h5:/g/points", "10000000 2"), item("a.h5:/g/u", "44"))
            refused(zipped(a_xdmf=big, a_h5=zeros), "u.zip", "more data than the limit", max_bytes=10**6)
            packed = zlib.compress(bytes(30_000_000))

            def expanding(file: h5py.File) -> None:
                made = file.create_dataset("g/points", (44, 2), "f8", chunks=(44, 2), compression="gzip")
                made.id.write_direct_chunk((0, 0), packed)

            refused(zipped(a_xdmf=IN_H5, a_h5=h5(expanding)), "u.zip", "expands to more than it says")
            assert tracemalloc.get_traced_memory()[1] < 35_000_000  # what the test itself packs
        finally:
            tracemalloc.stop()

    @pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
    def test_entities_are_refused_in_any_encoding(self, encoding: str) -> None:
        head = f"<?xml version='1.0' encoding='{encoding}'?>"
        for name, tag in (("u.xdmf", "Xdmf"), ("u.vtu", "VTKFile")):
            laughs = f'{head}<!DOCTYPE a [<!ENTITY b "bbbb">]><{tag}>&b;</{tag}>'
            refused(laughs.encode(encoding), name, "entities")

    @pytest.mark.parametrize(
        ("text", "word"),
        [
            ("<a/>", "starts with <a>"),
            ("<Xdmf/>", "no Grid"),
            ("<Xdmf>" * 60, "levels deep"),
            (XDMF.format(points="", more=""), "not one plain DataItem"),
            (XDMF.format(points=item("1 2", "1 two", "XML"), more=""), "Dimensions"),
            (XDMF.format(points=item("1 2 3", "3", "XML"), more=""), "3 coordinates"),
            (XDMF.format(points=item("1 2", "1 2", "Binary"), more=""), "'BINARY'"),
            (XDMF.format(points=item("1 2", "1 2", "XML"), more="").replace("XY", "VXVYVZ"), "'VXVYVZ'"),
            (XDMF.format(points=item("1 2", "1 2", "XML"), more=""), "named u"),
        ],
    )
    def test_broken(self, text: str, word: str) -> None:
        refused(text.encode(), "u.xdmf", word)


class TestAnyFile:
    def test_unknown_and_empty_files(self) -> None:
        refused(b"1", "u.xlsx", "'u.xlsx'", "npz, npy, csv, json, vtu, vtk, xdmf")
        refused(b"1", "noname", "suffix")
        for suffix in READERS:
            refused(b"", f"u.{suffix}", "is empty")
            refused(b" \n", f"u.{suffix}", "is empty")
        refused(b"0,0,1\n" * 10, "u.csv", "60 bytes", "50 allowed", max_bytes=50)
        assert MAX_BYTES == 256 * 2**20

    def test_every_member_of_a_zip_is_bounded_together(self) -> None:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in ("x", "y", "values"):
                archive.writestr(f"{name}.npy", npy(np.zeros(50_000)))
        refused(stream.getvalue(), "u.npz", "unpacks to more than", max_bytes=900_000)
