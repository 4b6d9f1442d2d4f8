"""The names of the artifacts of a mesh."""

from __future__ import annotations

from itertools import product

from equimesh.io.write import FORMATS
from equimesh_service.worker.job import MESH, PICTURES, PLOTS, file_name, plot_name


def test_each_file_and_picture_has_a_name_of_its_own() -> None:
    files = [file_name(*of) for of in product(FORMATS, ("quad", "triangle"), (1, 2))]
    pictures = [plot_name(kind, format) for kind, format in product(PLOTS, PICTURES)]
    assert len({*files, *pictures}) == len(files) + len(pictures)
    assert file_name("npz", "quad") == MESH  # the mesh as it was computed is no export
