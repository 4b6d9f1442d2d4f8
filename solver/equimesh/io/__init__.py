"""Mesh files: writing them in every format, and reading npz back."""

from equimesh.io.npz import load_npz
from equimesh.io.write import CELLS, FORMATS, Cells, MeshFormat, write_mesh
from equimesh.meshes.mesh_data import MeshData

__all__ = ["CELLS", "FORMATS", "Cells", "MeshData", "MeshFormat", "load_npz", "write_mesh"]
