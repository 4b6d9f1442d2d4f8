"""Mesh files: writing them in every format, reading npz back, and files of meshes in parts."""

from equimesh.io.by_parts.contents import PartData
from equimesh.io.by_parts.formats import PARTED_FORMATS, PartedFormat
from equimesh.io.by_parts.read import PartedMesh, read_parts
from equimesh.io.by_parts.write import remove_parted, write_head, write_part
from equimesh.io.npz import load_npz
from equimesh.io.write import CELLS, FORMATS, Cells, MeshFormat, write_mesh
from equimesh.meshes.mesh_data import MeshData

__all__ = [
    "CELLS",
    "FORMATS",
    "PARTED_FORMATS",
    "Cells",
    "MeshData",
    "MeshFormat",
    "PartData",
    "PartedFormat",
    "PartedMesh",
    "load_npz",
    "read_parts",
    "remove_parted",
    "write_head",
    "write_mesh",
    "write_part",
]
