"""Uploaded meshes that are domains: they are read and checked once, and kept as arrays, as samples are.

Their blocks are found when a mesh is requested, since the corners are part of its spec. A file may also describe them,
as a blockMeshDict does: its description is kept as JSON.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from equimesh import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.read import BLOCK_MESH_DICT, FORMAT_OF, description_format, read_bytes, read_description

Arrays: TypeAlias = Mapping[str, Any]
# The kind of the stored samples that are a mesh.
MESH = "mesh"
# The start of the names of the arrays of sides.
_SIDE = "side_"


def convert_mesh(source: Path, filename: str, target: Path, most_points: int) -> dict[str, Any]:
    """Read the mesh in ``source``, write its arrays to an npz file, and return a summary.

    The suffix of ``filename`` tells the format. Raises :class:`~equimesh.errors.InputError` for a mesh that is none of
    quadrilaterals, or that has too many points.
    """
    described = description_format(filename)
    if described is not None:
        return _convert_description(read_description(source, described), target, most_points)
    suffix = Path(filename).suffix.lower()
    if suffix not in FORMAT_OF:
        known = ", ".join([*FORMAT_OF, ".json", BLOCK_MESH_DICT])
        raise InputError(f"{filename[:80]!r} is not the name of a mesh that is read; there are {known}")
    mesh = read_bytes(source.read_bytes(), FORMAT_OF[suffix])
    _check_size(len(mesh.points), most_points)
    with target.open("wb") as file:
        _write(mesh, file)
    return {"kind": MESH, "shape": [len(mesh.points), len(mesh.cells)], "sides": list(mesh.sides)}


def _convert_description(document: dict[str, Any], target: Path, most_points: int) -> dict[str, Any]:
    """Write a checked description as JSON to an npz file, and return a summary."""
    layout = plan_of(Description.of(document)).layout
    _check_size(layout.node_count, most_points)
    text = np.frombuffer(json.dumps(document, allow_nan=False).encode(), dtype=np.uint8)
    with target.open("wb") as file:
        np.savez(file, description=text)
    return {"kind": MESH, "shape": [layout.node_count, layout.cell_count], "sides": list(document.get("sides", ()))}


def _check_size(points: int, most_points: int) -> None:
    if points > most_points:
        raise InputError(f"the mesh has {points} points; this service takes at most {most_points}")


def blocks_of(mesh: Path | Arrays, settings: Mapping[str, Any]) -> Blocks:
    """The blocks of a stored mesh, by the ``corners`` and the ``corner_angle`` of a spec."""
    arrays = _load(mesh) if isinstance(mesh, Path) else mesh
    if "description" in arrays:
        if settings:
            raise InputError("a description has its own corners: leave corners and corner_angle out", field="corners")
        return Blocks.of(json.loads(arrays["description"].tobytes()))
    names = _stored_names(arrays)
    plain = PlainMesh(
        points=arrays["points"],
        cells=arrays["cells"],
        sides={name: arrays[f"{_SIDE}{number}"] for number, name in enumerate(names["names"])},
        places=dict(zip(names["place_names"], arrays["places"].tolist(), strict=True)),
        blocks=tuple(zip(names["block_names"], arrays.get("block_sizes", np.empty(0)).tolist(), strict=True)),
    )
    return Blocks.of_plain(plain, **settings)


def _stored_names(arrays: Arrays) -> dict[str, list[str]]:
    """The names of sides, points and blocks. Earlier releases stored an array of each, or none."""
    if "all_names" in arrays:
        found: dict[str, list[str]] = json.loads(arrays["all_names"].tobytes())
        return found
    return {kind: arrays[kind].tolist() if kind in arrays else [] for kind in ("names", "place_names", "block_names")}


def _write(mesh: PlainMesh, file: IO[bytes]) -> None:
    """Write the arrays of a mesh; its names are one text, since NumPy gives each the length of the longest."""
    names = {
        "names": list(mesh.sides),
        "place_names": list(mesh.places),
        "block_names": [name for name, _ in mesh.blocks],
    }
    arrays: dict[str, Any] = {
        "points": mesh.points,
        "cells": mesh.cells,
        "all_names": np.frombuffer(json.dumps(names).encode(), dtype=np.uint8),
        "places": np.array(list(mesh.places.values()), dtype=np.int64),
        "block_sizes": np.array([size for _, size in mesh.blocks], dtype=np.int64),
    }
    arrays |= {f"{_SIDE}{number}": edges for number, edges in enumerate(mesh.sides.values())}
    np.savez(file, **arrays)


def _load(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)
