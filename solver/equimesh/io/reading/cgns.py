"""Meshes from CGNS files of structured zones, which are HDF5 files."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import h5py
import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.plot3d import joined
from equimesh.numerics.types import Array, IntArray

# How the first bytes of an HDF5 file, and of the older ADF file, begin.
HDF5, ADF = b"\x89HDF", b"ADF"
# Zones of a file, and nodes of a zone along a direction, at most.
MAX_ZONES, MAX_NODES = 10_000, 10_000_000
# Where a boundary condition lies: at nodes, ...
AT_NODES: Final = "Vertex"
# ... or on faces, whose numbers are those of cells along the side.
ON_FACES: Final = ("FaceCenter", "EdgeCenter", "IFaceCenter", "JFaceCenter")
# What a broken file raises; MemoryError: the library trusts the sizes in a broken head.
BROKEN: Final = (OSError, RuntimeError, LookupError, ValueError, TypeError, OverflowError, MemoryError)


def read_cgns(data: bytes) -> PlainMesh:
    """The mesh of a CGNS file with plane structured zones, with three axes of one layer.

    Nodes of zones at the same place become one node, as 1-to-1 connectivity has them. Zones are blocks, with their
    names. Boundary conditions with a range of points are sides: those of one family are one side with its name, others
    have their own name. Raises :class:`~equimesh.errors.InputError` for other zones, for data in other files, and for a
    broken file; the message has the zone.

    Sources: CGNS SIDS, "Zone definition" and "Boundary conditions"; CGNS file mapping manual, "HDF5".
    """
    if not data.startswith(HDF5):
        remedy = "convert it by cgnsconvert to HDF5" if ADF in data[:64] else "save it again"
        raise InputError(f"the CGNS file is no HDF5 file: {remedy}", field="file")
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            bases = list(_children(file, "CGNSBase_t"))
            zones = [(name, zone) for _, base in bases for name, zone in _children(base, "Zone_t")]
            if len(bases) != 1 or not 1 <= len(zones) <= MAX_ZONES:
                message = f"the CGNS file has {len(bases)} bases and {len(zones)} zones: one base with zones is read"
                raise InputError(message, field="file")
            blocks = _blocks(zones, len(data))
            sides: dict[str, list[tuple[int, IntArray]]] = {}
            left = sum(2 * sum(block.shape[:2]) for block in blocks)  # edges that may have a side yet
            for number, (name, zone) in enumerate(zones):
                for side, edges in _sides(name, zone, blocks[number].shape):
                    left -= len(edges)
                    if left < 0:
                        message = f"the zone {name!r}: the sides have more edges than the zones: give each one side"
                        raise InputError(message, field="file")
                    sides.setdefault(side, []).append((number, edges))
    except InputError:
        raise
    except BROKEN as error:
        raise InputError(f"the CGNS file cannot be read: {str(error)[:200]}", field="file") from error
    named = tuple((name, (b.shape[0] - 1) * (b.shape[1] - 1)) for (name, _), b in zip(zones, blocks, strict=True))
    return replace(joined(blocks, sides), blocks=named)


def _blocks(zones: list[tuple[str, h5py.Group]], size: int) -> list[Array]:
    """The coordinates of all zones of a file of ``size`` bytes, of which each zone has its own."""
    blocks: list[Array] = []
    left = size
    for name, zone in zones:
        blocks.append(_nodes(name, zone, size))
        left -= blocks[-1].size  # a number has one byte at least
        if left < 0:
            message = f"the zone {name!r} has more nodes than the file has place for: save each zone with its own array"
            raise InputError(message, field="file")
    return blocks


def _children(group: h5py.Group, label: str) -> Iterator[tuple[str, h5py.Group]]:
    """The nodes of a kind below a node, in the order in which they were made, where the file has it."""
    names: list[bytes] = []
    tracked = group.id.get_create_plist().get_link_creation_order() & h5py.h5p.CRT_ORDER_TRACKED
    order = h5py.h5.INDEX_CRT_ORDER if tracked else h5py.h5.INDEX_NAME
    group.id.links.iterate(names.append, idx_type=order)
    for name in (bytes(raw).decode() for raw in names):
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            child = group[name]
            found = child.attrs.get("label", b"")
            text = found.decode() if isinstance(found, bytes) else str(found)
            if isinstance(child, h5py.Group) and text.rstrip("\0 ") == label:
                yield name, child


def _data(node: h5py.Group, where: str, most: int) -> Any:
    """The array of a node, of ``most`` bytes at most; its axes are in the order of Fortran backwards."""
    dataset = node.get(" data") if isinstance(node.get(" data", getlink=True), h5py.HardLink) else None
    if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual or dataset.chunks is not None:
        message = f"{where} has no plain array: save the file as one, without links and packing"
        raise InputError(message, field="file")
    if dataset.dtype.kind not in "fiuS" or dataset.nbytes > most:
        raise InputError(f"{where} has {dataset.size} entries of the type {dataset.dtype}", field="file")
    return dataset[()]


def _text(node: h5py.Group, where: str) -> str:
    """The text of a node, which is an array of characters."""
    return bytes(np.asarray(_data(node, where, 1 << 16)).astype(np.uint8)).decode().strip("\0 ")


def _nodes(name: str, zone: h5py.Group, most: int) -> Array:
    """The coordinates of a zone, shape ``(n_i, n_j, 2 or 3)``."""
    where = f"the zone {name!r}"
    kinds = [_text(node, f"{where}: ZoneType") for _, node in _children(zone, "ZoneType_t")]
    if kinds != ["Structured"]:
        message = f"{where} is {' '.join(kinds) or 'of no type'}: structured zones are read; save it as .vtu"
        raise InputError(message, field="file")
    shape = np.atleast_2d(_data(zone, where, most))[0].tolist()
    n_k = shape[2] if len(shape) == 3 else 1
    if len(shape) not in (2, 3) or not all(2 <= n <= MAX_NODES for n in shape[:2]) or n_k not in (1, 2):
        sizes = " x ".join(map(str, shape))
        message = f"{where} has {sizes} nodes: plane zones, or one layer of cells along k, can be adapted"
        raise InputError(message, field="file")
    arrays = {
        axis: node
        for _, grid in list(_children(zone, "GridCoordinates_t"))[:1]
        for axis, node in _children(grid, "DataArray_t")
    }
    found = []
    for axis in ("CoordinateX", "CoordinateY", "CoordinateZ"):
        if axis not in arrays:
            if axis != "CoordinateZ":
                raise InputError(f"{where} has no {axis}: x and y are needed", field="file")
            continue
        values = np.asarray(_data(arrays[axis], f"{where}: {axis}", most), dtype=np.float64)
        if values.shape != tuple(shape[::-1]):
            message = f"{where}: {axis} has {values.shape[::-1]} nodes where the zone has {tuple(shape)}"
            raise InputError(message, field="file")
        found.append((values[0] if len(shape) == 3 else values).T)
    return np.stack(found, axis=-1)


def _sides(name: str, zone: h5py.Group, shape: tuple[int, ...]) -> Iterator[tuple[str, IntArray]]:
    """The name of each boundary condition of a zone, and its edges of nodes ``i * n_j + j``, shape ``(k, 2)``."""
    for _, conditions in _children(zone, "ZoneBC_t"):
        for own, condition in _children(conditions, "BC_t"):
            where = f"the zone {name!r}: the boundary condition {own!r}"
            side = next((_text(node, where) for _, node in _children(condition, "FamilyName_t")), own)
            ranges = [node for title, node in _children(condition, "IndexRange_t") if title == "PointRange"]
            if len(ranges) != 1:
                raise InputError(f"{where} has no PointRange: give the range of its points", field="file")
            at = next((_text(node, where) for _, node in _children(condition, "GridLocation_t")), AT_NODES)
            edges = _edges(np.asarray(_data(ranges[0], where, 1 << 16)), at, shape[:2], where)
            if edges is not None:
                yield side, edges


def _edges(ends: IntArray, at: str, shape: tuple[int, ...], where: str) -> IntArray | None:
    """The edges of a range of points, shape ``(2, axes)``, which begins at 1; none for a face in the plane itself."""
    if ends.ndim != 2 or ends.shape[0] != 2 or ends.shape[1] not in (2, 3) or at not in (AT_NODES, *ON_FACES):
        raise InputError(f"{where}: a PointRange at {at} of the shape {ends.shape[::-1]} is not read", field="file")
    low, high = (limit(ends[:, :2].astype(np.int64), axis=0) for limit in (np.min, np.max))
    if ends.shape[1] == 3 and ends[0, 2] == ends[1, 2] and (low < high).all():
        return None
    for along, across in ((1, 0), (0, 1)):
        first, last = int(low[along]), int(high[along]) + (at != AT_NODES)
        fixed = int(low[across])
        if fixed != high[across] or fixed not in (1, shape[across]) or not 1 <= first < last <= shape[along]:
            continue
        steps = np.arange(first - 1, last)
        line = (fixed - 1) * shape[1] + steps if along == 1 else steps * shape[1] + fixed - 1
        return np.column_stack([line[:-1], line[1:]])
    message = (
        f"{where} has the points {low.tolist()} to {high.tolist()}, which are no part of a side of the"
        f" {shape[0]} x {shape[1]} nodes"
    )
    raise InputError(message, field="file")
