"""CGNS files of structured zones, written by h5py as the CGNS library lays them out."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from equimesh.numerics.types import Array

# A boundary condition: its name, range of points, family and location.
Condition = tuple[str, Sequence[Sequence[int]], str, str]


def node(parent: h5py.Group, name: str, label: str, data: Any = None, kind: str = "MT") -> h5py.Group:
    """A node of the tree; the axes of its data are those of Fortran backwards."""
    group = parent.create_group(name, track_order=True)
    for key, value in (("name", name), ("label", label), ("type", kind)):
        group.attrs[key] = np.bytes_(value)
    if isinstance(data, str):
        data = np.frombuffer(data.encode(), np.int8)
    if data is not None:
        group.create_dataset(" data", data=data)
    return group


def cgns(zones: Mapping[str, tuple[Array, Sequence[Condition]]], axes: int = 2, kind: str = "Structured") -> bytes:
    """A file whose zones have nodes, shape ``(n_i, n_j, 2)``; with three ``axes`` one layer of cells along k."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", track_order=True) as file:
        base = node(file, "Base", "CGNSBase_t", np.array([axes, axes], np.int32), "I4")
        node(base, "Flow", "Family_t")
        for name, (points, conditions) in zones.items():
            shape = np.array([*points.shape[:2], 2][:axes], np.int32)
            zone = node(base, name, "Zone_t", np.stack([shape, shape - 1, 0 * shape]), "I4")
            node(zone, "ZoneType", "ZoneType_t", kind, "C1")
            grid = node(zone, "GridCoordinates", "GridCoordinates_t")
            for axis, values in zip("XY", points.transpose(2, 1, 0), strict=True):
                node(grid, f"Coordinate{axis}", "DataArray_t", np.stack([values] * 2) if axes == 3 else values, "R8")
            if axes == 3:
                layers = np.stack([np.full(points.shape[1::-1], z) for z in (0.0, 0.1)])
                node(grid, "CoordinateZ", "DataArray_t", layers, "R8")
            listed = node(zone, "ZoneBC", "ZoneBC_t")
            for own, ends, family, at in conditions:
                condition = node(listed, own, "BC_t", "FamilySpecified" if family else "BCWall", "C1")
                if ends:
                    node(condition, "PointRange", "IndexRange_t", np.array(ends, np.int32), "I4")
                if family:
                    node(condition, "FamilyName", "FamilyName_t", family, "C1")
                if at:
                    node(condition, "GridLocation", "GridLocation_t", at, "C1")
    return stream.getvalue()
