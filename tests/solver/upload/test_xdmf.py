"""XDMF files: numbers as text or in HDF5 members of a zip, nothing from elsewhere, no bombs."""

from __future__ import annotations

import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from equimesh.io.write import Cells, MeshData, write_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.upload.samples import read_samples
from solver.upload.files import CLOUD, CLOUD_U, TABLE, X, Y, check_cloud, check_grid, refused
from solver.upload.markup import IN_H5, XDMF, h5, item, with_cloud, xdmf, zipped


class TestXdmf:
    @pytest.mark.parametrize("cells", ["quad", "triangle"])
    def test_what_we_write(self, tmp_path: Path, cells: Cells) -> None:
        x, y = np.meshgrid(X, Y, indexing="ij")
        per_cell = np.ones((len(X) - 1, len(Y) - 1))
        data = MeshData(mesh=Mesh(x, y), u=TABLE, q_eq=per_cell, subdomain=per_cell.astype(np.int64))
        (path,) = write_mesh(tmp_path / "mesh.xdmf.zip", data, cells=cells)
        check_grid(read_samples(path.read_bytes(), path.name))
        check_grid(read_samples(path.read_bytes(), "u.xdmf"))

    def test_what_dolfinx_writes_is_refused_with_a_way_out(self) -> None:
        """``XDMFFile.write_mesh`` and ``write_function``: the function lies in a series whose mesh is a reference."""
        head = b'<?xml version="1.0"?><!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>'
        refused(zipped(a_xdmf=head + IN_H5, a_h5=h5(with_cloud)), "u.zip", "document type", "dolfinx", ".npz")
        refused(head + IN_H5, "u.xdmf", "document type", "dolfinx", ".npz")

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

            refused(zipped(a_xdmf=IN_H5, a_h5=h5(expanding)), "u.zip", "expands to more than its stated size")
            assert tracemalloc.get_traced_memory()[1] < 35_000_000  # what the test itself packs
        finally:
            tracemalloc.stop()

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
            (XDMF.format(points=item("1 2", "1 2", "XML"), more=""), "no scalar point data"),
        ],
    )
    def test_broken(self, text: str, word: str) -> None:
        refused(text.encode(), "u.xdmf", word)
