"""Mesh files: writing them in every format, and reading npz back."""

from typing import NoReturn

from equimesh.io.npz import load_npz
from equimesh.io.write import CELLS, FORMATS, Cells, MeshFormat, write_mesh
from equimesh.meshes.mesh_data import MeshData

__all__ = ["CELLS", "FORMATS", "Cells", "MeshData", "MeshFormat", "load_npz", "write_mesh"]

_MOVED = {
    "PARTED_FORMATS", "PartData", "PartedFormat", "PartedMesh", "read_parts", "remove_parted", "write_head",
    "write_part",
}  # fmt: skip


def __getattr__(name: str) -> NoReturn:
    if name in _MOVED:
        raise ImportError(f"equimesh.io.{name} is equimesh_cluster.{name} now")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
