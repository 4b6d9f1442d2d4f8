"""Mesh files: writing them in every format, and reading npz back."""

from equimesh.io.npz import load_npz
from equimesh.io.write import CELLS, FORMATS, write_mesh

__all__ = ["CELLS", "FORMATS", "load_npz", "write_mesh"]
