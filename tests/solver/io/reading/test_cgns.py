"""Meshes from CGNS files of structured zones."""

from __future__ import annotations

import io
import re

import h5py
import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.io.reading.read import read_bytes
from equimesh.numerics.types import Array
from solver.io.reading.cgns_files import Condition, cgns
from solver.io.reading.plain import refusal


def zone(x: float, y: float, n_i: int, n_j: int) -> Array:
    """Nodes of a rectangle of cells of the size 1, shape ``(n_i, n_j, 2)``."""
    return np.stack(np.meshgrid(x + np.arange(n_i), y + np.arange(n_j), indexing="ij"), axis=-1).astype(float)


def l_shape(axes: int = 2) -> dict[str, tuple[Array, list[Condition]]]:
    """Three zones, with sides at nodes, on faces, and of a family."""
    last = [] if axes == 2 else [1], [] if axes == 2 else [2]

    def span(i: int, j: int, i_end: int, j_end: int) -> list[list[int]]:
        return [[i, j, *last[0]], [i_end, j_end, *last[1]]]

    return {
        "zone 10": (zone(0, 0, 4, 3), [("bc1", span(1, 1, 4, 1), "floor", ""), ("inlet", span(1, 1, 1, 3), "", "")]),
        "zone 2": (
            zone(3, 0, 3, 3),
            [("bc1", span(1, 1, 2, 1), "floor", "JFaceCenter"), ("out", span(3, 1, 3, 2), "", "FaceCenter")],
        ),
        "zone 1": (zone(0, 2, 4, 2), [("inlet", span(1, 1, 1, 2), "", "Vertex")]),
    }


@pytest.mark.parametrize("axes", [2, 3])
def test_zones_are_blocks_and_boundary_conditions_are_sides(axes: int) -> None:
    found = read_bytes(cgns(l_shape(axes), axes), "cgns")
    assert found.blocks == (("zone 10", 6), ("zone 2", 4), ("zone 1", 3))
    assert len(found.points) == 12 + 6 + 4
    assert list(found.sides) == ["floor", "inlet", "out"]
    middle = {name: found.points[edges].mean(axis=1).tolist() for name, edges in found.sides.items()}
    assert middle["floor"] == [[0.5, 0], [1.5, 0], [2.5, 0], [3.5, 0], [4.5, 0]]
    assert middle["inlet"] == [[0, 0.5], [0, 1.5], [0, 2.5]]
    assert middle["out"] == [[5, 0.5], [5, 1.5]]
    domain = Blocks.of_plain(found)
    assert domain.mesh.block_names == ("zone 10", "zone 2", "zone 1")
    assert domain.area == pytest.approx(13)


def test_faces_in_the_plane_are_no_side() -> None:
    zones = l_shape(3)
    zones["zone 1"][1].append(("front", [[1, 1, 1], [4, 2, 1]], "", ""))
    assert list(read_bytes(cgns(zones, 3), "cgns").sides) == ["floor", "inlet", "out"]


def test_what_is_wrong_is_named_with_its_zone() -> None:
    good = l_shape()
    nodes = good["zone 2"][0]

    def with_condition(*condition: object) -> bytes:
        return cgns(good | {"zone 2": (nodes, [condition])})

    for data, message in [
        (b"\x00ADF Database", "the CGNS file is no HDF5 file: convert it by cgnsconvert to HDF5"),
        (b"CGNS", "the CGNS file is no HDF5 file: save it again"),
        (cgns({}), "the CGNS file has 1 bases and 0 zones"),
        (cgns(good, kind="Unstructured"), "the zone 'zone 10' is Unstructured: structured zones are read; save it as"),
        (with_condition("w", [[1, 1], [9, 1]], "", ""), "the zone 'zone 2': the boundary condition 'w' has the points"),
        (with_condition("w", [[2, 1], [2, 3]], "", ""), r"points \[2, 1\] to \[2, 3\], which are no part of a side"),
        (with_condition("w", [[1, 1], [3, 1]], "", "JFaceCenter"), "which are no part of a side of the 3 x 3 nodes"),
        (with_condition("w", [[1, 1], [3, 1]], "", "CellCenter"), "a PointRange at CellCenter of the shape"),
        (with_condition("w", [], "", ""), "the boundary condition 'w' has no PointRange: give the range of its points"),
    ]:
        found = refusal(data, "cgns")
        assert re.search(message, found), found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("gone", "the zone 'zone 2' has no CoordinateY: x and y are needed"),
        ("link", "the zone 'zone 2' has no CoordinateY: x and y are needed"),
        ("packed", "the zone 'zone 2': CoordinateY has no plain array: save the file as one"),
        ("small", "the zone 'zone 2': CoordinateY has (2, 3) nodes where the zone has (3, 3)"),
        ("text", "the zone 'zone 2': CoordinateY has 3 entries of the type"),
    ],
)
def test_coordinates_that_cannot_be_read_are_named(change: str, message: str) -> None:
    stream = io.BytesIO(cgns(l_shape()))
    with h5py.File(stream, "r+") as file:
        grid = file["Base/zone 2/GridCoordinates"]
        if change in ("gone", "link"):
            del grid["CoordinateY"]
        if change == "link":
            grid["CoordinateY"] = h5py.ExternalLink("/etc/passwd", "/data")
        if change in ("packed", "small", "text"):
            del grid["CoordinateY/ data"]
            if change == "packed":
                grid.create_dataset("CoordinateY/ data", data=np.zeros((3, 3)), compression="gzip")
            elif change == "small":
                grid.create_dataset("CoordinateY/ data", data=np.zeros((3, 2)))
            else:
                grid.create_dataset("CoordinateY/ data", data=["a", "b", "c"])
    assert message in refusal(stream.getvalue(), "cgns")


def test_zones_that_share_one_array_are_refused() -> None:
    stream = io.BytesIO(cgns({"zone": (np.moveaxis(np.indices((60, 60), dtype=np.float64), 0, 2), [])}))
    with h5py.File(stream, "r+") as file:
        for number in range(9):
            file[f"Base/again {number}"] = file["Base/zone"]
    with pytest.raises(InputError, match=r"has more nodes than the file has place for: save each zone"):
        read_bytes(stream.getvalue(), "cgns")


def test_sides_with_more_edges_than_the_zones_are_refused() -> None:
    ends = [[1, 1], [4, 1]]
    conditions = [(f"wall {number}", ends, "", "") for number in range(6)]
    with pytest.raises(InputError, match="the sides have more edges than the zones"):
        read_bytes(cgns({"zone": (np.moveaxis(np.indices((4, 3), dtype=np.float64), 0, 2), conditions)}), "cgns")
