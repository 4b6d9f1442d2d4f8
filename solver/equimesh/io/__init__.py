"""Mesh files: writing them in every format, and reading npz back."""

from equimesh.io.write import CELLS, FORMATS, load_npz, write_mesh

__all__ = ["CELLS", "FORMATS", "load_npz", "write_mesh"]
