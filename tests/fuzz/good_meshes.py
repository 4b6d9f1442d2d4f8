"""Mesh files of every kind that are read, and parts that break them."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import meshio
import numpy as np

from equimesh.io.solver_files import foam_files, gmsh_text, su2_text
from equimesh.io.vtk import write_vtu
from solver.io.reading.cgns_files import cgns
from solver.io.reading.plain import small
from solver.io.reading.test_structured import text, two_blocks

MESH_PARTS = [
    b"$Elements\n999999999\n",
    b'$PhysicalNames\n1\n1 1 "\x00"\n',
    b"1e400",
    b"NELEM= -1\n",
    b"MARKER_TAG= \xff\n",
    b"9999999*1 ",
    b"$v",
    b"#calc",
    b"((((((((",
    b"{",
    b'"\\ud800"',
    b"CGNSBase_t",
    b"<!DOCTYPE a>",
]
PACKINGS = {
    "stored": zipfile.ZIP_STORED,
    "deflate": zipfile.ZIP_DEFLATED,
    "bz2": zipfile.ZIP_BZIP2,
    "lzma": zipfile.ZIP_LZMA,
}


def good_meshes(folder: Path) -> dict[str, tuple[str, list[bytes]]]:
    """For each kind of mesh file the name that it is sent with, and files of this kind."""
    mesh, zeros = small(), np.zeros(6, int)
    write_vtu(folder / "mesh.vtu", mesh.points, mesh.cells, point_data={}, cell_data={})
    msh = gmsh_text(mesh.points, mesh.cells, mesh.sides, subdomain=zeros, point_data={}, cell_data={})
    poly_mesh = foam_files(mesh.points, mesh.cells, mesh.sides)
    zone = (mesh.points.reshape(4, 3, 2), [("left", [[1, 1], [1, 3]], "", "")])
    return {
        "msh": ("m.msh", [msh.encode(), *binary_msh(folder)]),
        "vtu": ("m.vtu", [(folder / "mesh.vtu").read_bytes()]),
        "su2": ("m.su2", [su2_text(mesh.points, mesh.cells, mesh.sides).encode()]),
        "p3d": ("m.p3d", [text(two_blocks())]),
        "cgns": ("m.cgns", [cgns({"zone": zone})]),
        "json": ("m.json", [described()]),
        "blockMeshDict": ("blockMeshDict", [block_mesh_dict()]),
        **{f"zip, {name}": ("m.zip", [packed(poly_mesh, method)]) for name, method in PACKINGS.items()},
    }


def binary_msh(folder: Path) -> list[bytes]:
    """Binary Gmsh files of both versions, by meshio."""
    mesh, found = small(), []
    tags = {name: [np.full(6, 5)] for name in ("gmsh:physical", "gmsh:geometrical")}
    for form in ("gmsh22", "gmsh"):
        written = meshio.Mesh(np.pad(mesh.points, ((0, 0), (0, 1))), [("quad", mesh.cells)], cell_data=tags)
        if form == "gmsh":
            written.point_data["gmsh:dim_tags"] = np.full((len(mesh.points), 2), (2, 5))
        meshio.write(folder / "binary.msh", written, file_format=form, binary=True)
        found.append((folder / "binary.msh").read_bytes())
    return found


def described() -> bytes:
    """A description of one block."""
    corners = {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}
    block = {"corners": [*corners], "cells": [3, 2]}
    return json.dumps({"vertices": corners, "blocks": [block], "sides": {"s": [["a", "b"]]}}).encode()


def block_mesh_dict() -> bytes:
    """The same for OpenFOAM, with a variable."""
    vertices = " ".join(f"({x} {y} {z})" for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    block = "hex (0 1 2 3 4 5 6 7) $cells simpleGrading (1 1 1)"
    return f"cells (3 2 1);\nvertices ({vertices});\nblocks ({block});\n".encode()


def packed(files: dict[str, str], method: int) -> bytes:
    """A zip of files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()
