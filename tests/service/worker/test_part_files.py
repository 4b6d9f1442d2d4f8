"""Files of meshes in parts: written, and made in other formats from what was written first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import equimesh
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.part_files.parted_mesh import read_parts
from equimesh_service.worker.in_parts import PartsLayout, convert_part_file, write_head_file, write_part_file
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS, WRITTEN
from service.parts import CUTS, SHAPE, bent_mesh, u_of

LAYOUT = PartsLayout(name="m-1", grid=equimesh.Grid(n_xi=SHAPE[0], n_eta=SHAPE[1]), firsts=(0, *CUTS), nodes=("u",))


def written(folder: Path) -> list[Path]:
    files = []
    for part in cut(bent_mesh(), CUTS):
        files.append(folder / f"{part.number}.vtu")
        write_part_file(files[-1], part, {"u": u_of}, WRITTEN)
    return files


def test_a_layout_is_what_its_record_says() -> None:
    assert LAYOUT.record() == {"name": "m-1", "rows": [[0, 6], [6, 12], [12, 17]], "nodes": ["u"]}
    assert PartsLayout.of(LAYOUT.record(), LAYOUT.grid) == LAYOUT


@pytest.mark.parametrize("format", HEADED)
def test_parts_in_every_format_open_as_one_mesh(tmp_path: Path, format: str) -> None:
    mesh, form = bent_mesh(), PART_FORMATS[format]
    (tmp_path / "m-1").mkdir()
    for number, source in enumerate(written(tmp_path)):
        convert_part_file(source, tmp_path / form.path_of_part("m-1", number), LAYOUT, number, format)
    write_head_file(tmp_path / form.head_name("m-1"), LAYOUT, format)
    found = read_parts(tmp_path / form.head_name("m-1"))
    assert found.cuts == CUTS
    for name, values in (("x", mesh.x), ("y", mesh.y), ("u", u_of(mesh.x, mesh.y))):
        np.testing.assert_array_equal(found.rows(name, 0, SHAPE[0]), values)


def test_a_part_in_the_format_of_the_first_writing_is_the_same_file(tmp_path: Path) -> None:
    source = written(tmp_path)[1]
    convert_part_file(source, tmp_path / "again.vtu", LAYOUT, 1, WRITTEN)
    assert (tmp_path / "again.vtu").read_bytes() == source.read_bytes()


def test_the_arrays_of_a_part(tmp_path: Path) -> None:
    convert_part_file(written(tmp_path)[1], tmp_path / "1.npz", LAYOUT, 1, "npz")
    mesh = bent_mesh()
    with np.load(tmp_path / "1.npz") as file:
        np.testing.assert_array_equal(file["x"], mesh.x[6:13])
        np.testing.assert_array_equal(file["u"], u_of(mesh.x, mesh.y)[6:13])
