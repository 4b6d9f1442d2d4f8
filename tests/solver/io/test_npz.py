"""npz files: every array as it was, and refusals of what is no mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.npz import load_npz
from equimesh.io.write import Cells, write_mesh
from equimesh.meshes.mesh import SIDES
from solver.io.files import DATA, KINDS, check_cells, check_edges, per_cell, written


@pytest.mark.parametrize("kind", KINDS)
def test_npz(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "npz", kind)
    with np.load(path, allow_pickle=False) as arrays:
        assert set(arrays) == {"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES}
        check_cells(DATA.mesh.points, arrays["cells"], kind)
        np.testing.assert_array_equal(arrays["q_eq"], per_cell(DATA.q_eq, kind))
        np.testing.assert_array_equal(arrays["subdomain"], per_cell(DATA.subdomain, kind))
        for side in SIDES:
            check_edges(DATA.mesh.points, arrays[side], side)
    again = load_npz(path)
    pairs = [(again.mesh.x, DATA.mesh.x), (again.mesh.y, DATA.mesh.y)]
    pairs += [(getattr(again, name), getattr(DATA, name)) for name in ("u", "q_eq", "subdomain")]
    for found, expected in pairs:
        assert found.dtype == expected.dtype
        assert found.tobytes() == expected.tobytes()
        assert found.shape == expected.shape


@pytest.mark.parametrize("kind", KINDS)
def test_fields_vectors_and_the_json_of_a_step(tmp_path: Path, kind: Cells) -> None:
    x = DATA.mesh.x
    fields = {"p": x + 1, "velocity": np.stack([x, -x], axis=-1)}
    cell_fields = {"rho": x[1:, 1:], "flux": np.stack([x[1:, 1:]] * 4, axis=-1)}
    data = replace(DATA, fields=fields, cell_fields=cell_fields, step='{"status": "succeeded"}')
    again = load_npz(write_mesh(tmp_path / "mesh.npz", data, cells=kind)[0])
    assert again.step == data.step
    for found, expected in ((again.fields, fields), (again.cell_fields, cell_fields)):
        assert [*found] == [*expected]
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)


def test_files_that_are_no_result(tmp_path: Path) -> None:
    path = tmp_path / "mesh.npz"
    for content in (b"", b"text", b"PK\x03\x04 broken"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
            load_npz(path)
    for arrays in ({"x": np.ones(3)}, {n: np.ones((4, 4)) for n in ("x", "y", "u", "cells", "q_eq", "subdomain")}):
        np.savez(path, **arrays)
        with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
            load_npz(path)
    np.savez(path, x=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
        load_npz(path)
    with pytest.raises(FileNotFoundError):
        load_npz(tmp_path / "missing.npz")
