"""VTK files, XML and legacy: as other programs write them, broken, and hostile."""

from __future__ import annotations

import base64
import lzma
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.upload.samples import read_samples
from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import CLOUD, CLOUD_U, GRID_POINTS, TABLE, check_cloud, check_grid, refused
from solver.upload.markup import VTK_HEAD, vtu


def mesh_file(folder: Path, form: str, points: Any, data: dict[str, Any], **options: Any) -> bytes:
    path = folder / "u.mesh"
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("vertex", [[0], [1]])], point_data=data)
    meshio.write(path, mesh, file_format=form, **options)
    return path.read_bytes()


RAW = {"u": CLOUD_U.tobytes(), "Points": np.pad(CLOUD, ((0, 0), (0, 1))).tobytes()}


def compressed(data: bytes, pack: Callable[[bytes], bytes], *, declared: int | None = None) -> tuple[bytes, bytes]:
    """Header and blocks as VTK writes them, in blocks of 600 bytes."""
    blocks = [pack(data[k : k + 600]) for k in range(0, len(data), 600)]
    sizes = [len(block) for block in blocks]
    header = struct.pack(f"<{3 + len(sizes)}Q", declared or len(sizes), 600, len(data) % 600, *sizes)
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
        both = mesh_file(tmp_path, form, CLOUD, {"T": CLOUD_U, "p": CLOUD_U * 2}, **options)
        check_cloud(read_samples(both, f"u.{suffix}", column="T"))
        grid = mesh_file(tmp_path, form, GRID_POINTS, {"u": TABLE.ravel()}, **options)
        check_grid(read_samples(grid, f"u.{suffix}"))
        refused(
            mesh_file(tmp_path, form, CLOUD, {"p": CLOUD_U, "q": CLOUD_U}, **options),
            f"u.{suffix}",
            "choose u from p, q",
        )
        refused(mesh_file(tmp_path, form, CLOUD, {}, **options), f"u.{suffix}", "no scalar point data")
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


def test_a_count_of_points_takes_no_memory() -> None:
    head = b"# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS 999999999 double\n"
    check_bomb_is_refused(head, "u.vtk", "ends")


def test_a_long_line_is_not_repeated_as_a_whole() -> None:
    with pytest.raises(SamplesError, match="not ASCII or BINARY") as told:
        read_samples(b"# vtk DataFile Version 3.0\ntitle\n" + b"0.5 " * 3000 + b"\n", "u.vtk")
    assert len(str(told.value)) < 200
