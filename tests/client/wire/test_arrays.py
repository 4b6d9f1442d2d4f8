"""Arrays of a mesh, from an npz file."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import DownloadDamaged
from equimesh_client.wire.arrays import SIDES, Plot, arrays_of, plot_format


def npz(**more: Any) -> bytes:
    x, y = np.meshgrid([0.0, 0.5, 1.0], [0.0, 1.0], indexing="ij")
    arrays = {"x": x, "y": y, "cells": np.zeros((2, 4)), "q_eq": [[1.0], [2.0]], "subdomain": [[0], [1]]}
    arrays |= {side: np.array([[0, 1]]) for side in SIDES}
    file = io.BytesIO()
    np.savez(file, **{**arrays, **more})
    return file.getvalue()


def test_all_arrays_have_their_shapes() -> None:
    arrays = arrays_of(npz(u=np.ones((3, 2)), pressure=np.zeros((3, 2))))
    assert (arrays.x.shape, arrays.u.shape, arrays.points.shape) == ((3, 2), (3, 2), (6, 2))
    assert (arrays.q_eq.tolist(), arrays.subdomain.dtype) == ([[1.0], [2.0]], np.int64)
    assert (set(arrays.boundary), set(arrays.fields)) == (set(SIDES), {"pressure"})
    assert arrays_of(npz()).u is None


def test_two_triangles_share_the_value_of_a_cell() -> None:
    triangles = arrays_of(npz(cells=np.zeros((4, 3)), q_eq=[1.0, 1.0, 2.0, 2.0], subdomain=[0, 0, 1, 1]))
    assert (triangles.q_eq.tolist(), triangles.subdomain.tolist()) == ([[1.0], [2.0]], [[0], [1]])


def test_the_arrays_go_to_other_libraries_with_both_kinds_of_cells() -> None:
    number = np.arange(6).reshape(3, 2)
    lines = {"left": number[0, ::-1], "right": number[-1], "bottom": number[:, 0], "top": number[::-1, -1]}
    sides = {side: np.column_stack([line[:-1], line[1:]]) for side, line in lines.items()}
    arrays = arrays_of(npz(cells=[[0, 2, 3, 1], [2, 4, 5, 3]], **sides))
    quads, triangles = arrays.to_skfem(), arrays.to_skfem(cells="triangle")
    assert (quads.t.shape, triangles.t.shape) == ((4, 2), (3, 4))
    for mesh in (quads, triangles):
        found = {side: mesh.p[:, mesh.facets[:, facets]].reshape(2, -1).T for side, facets in mesh.boundaries.items()}
        assert {side: len(points) for side, points in found.items()} == {"left": 2, "right": 2, "bottom": 4, "top": 4}
        assert (found["left"][:, 0] == 0.0).all()
        assert (found["top"][:, 1] == 1.0).all()


@pytest.mark.parametrize("data", [b"", b"PK", npz()[:-40], npz(q_eq=np.ones(3)), npz(x=np.ones(3))])
def test_damage_is_reported(data: bytes) -> None:
    with pytest.raises(DownloadDamaged, match="npz file of the mesh"):
        arrays_of(data)


def test_ties_are_those_of_the_file_and_no_field() -> None:
    arrays = arrays_of(npz(**{"ties/nodes": [[4, 0], [5, 1]]}))
    assert arrays.ties.tolist() == [[4, 0], [5, 1]]
    assert not arrays.fields
    assert arrays_of(npz()).ties is None


# Pictures: their format, and how they are saved and shown.


@pytest.mark.parametrize(
    ("path", "format", "expected"),
    [(None, None, "svg"), ("a.png", None, "png"), ("a.PNG", "svg", "svg"), ("a", None, "svg"), ("a.gif", None, "gif")],
)
def test_the_format_follows_from_itself_then_the_suffix(path: str | None, format: str | None, expected: str) -> None:
    assert plot_format(path, format) == expected


def test_a_notebook_gets_the_format_that_there_is(tmp_path: Path) -> None:
    svg, png = Plot(data=b"<svg/>", format="svg"), Plot(data=b"\x89PNG", format="png")
    assert (svg._repr_svg_(), svg._repr_png_()) == ("<svg/>", None)
    assert (png._repr_svg_(), png._repr_png_()) == (None, b"\x89PNG")
    assert png.save(tmp_path / "a.png").read_bytes() == b"\x89PNG"
    assert "89PNG" not in repr(png)
