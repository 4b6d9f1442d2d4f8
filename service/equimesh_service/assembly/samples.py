"""Uploaded samples and meshes: they are read, checked, and made into fields and domains.

To interpolate many scattered samples takes seconds. It is done in a worker, which can be stopped. The linear algebra of
a worker runs on one thread, which is tens of times faster for the many small systems here.

Samples are interpolated once for a mesh, when its request is checked, since only then the domain is known: a small grid
in the process of the service, all others in a side worker. The result goes to the worker that solves
(:class:`~equimesh_service.admission.tasks.PackedProblems`). An upload without a spec is checked as far as that needs
no interpolation (``alone``).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

import equimesh
from equimesh import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.domains.domain import Box
from equimesh.errors import InputError, SamplesError
from equimesh.fields.samples import MIN_CUBIC, checked_grid
from equimesh.inputs import count_noun, real_array
from equimesh.io.npz import save_npz
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.read import BLOCK_MESH_DICT, FORMAT_OF, description_format, read_bytes, read_description
from equimesh.upload.columns import Limits
from equimesh.upload.nodal import block_nodes, checked_nodes, is_nodal
from equimesh.upload.samples import read_arrays, samples_of
from equimesh_service.files.port import StoredFile
from equimesh_service.spec.document import check_bounds
from equimesh_service.store.rows import NewSamples, SamplesRow

Arrays: TypeAlias = Mapping[str, Any]


def read(data: bytes, filename: str, limits: Limits, *, alone: bool, column: str | None = None) -> Arrays:
    """The canonical arrays of an upload; ``column`` is the name of u among its columns.

    ``alone`` says that they come without a domain: most faults on every domain are then found here, otherwise when a
    field is made of them. Raises :class:`~equimesh.errors.SamplesError`, and the problems of
    :func:`~equimesh_service.spec.document.check_bounds` for JSON.
    """
    if filename.lower().endswith(".json"):
        check_bounds(data, limits.max_values)
    sizes = {"max_bytes": limits.max_bytes, "max_samples": limits.max_samples}
    arrays = read_arrays(data, filename, column=column, **sizes)
    arrays = canonical_arrays(arrays)
    if alone and is_nodal(arrays):
        checked_nodes(**arrays)
    elif alone and "x" in arrays:
        checked_grid(**arrays)
    elif alone and "points" not in arrays and "nodes" not in arrays:
        x, y = map(np.arange, arrays["values"].shape)
        checked_grid(x, y, arrays["values"])
    return arrays


def row_of(file: StoredFile, summary: dict[str, Any], now: float) -> SamplesRow:
    """The row of samples whose id is part of the hash of their file."""
    return SamplesRow(f"s-{file.sha256[:32]}", file.sha256, file.size, summary, now)


def pack(arrays: Arrays, now: float) -> NewSamples:
    """Canonical arrays as samples that can be stored."""
    file = io.BytesIO()
    summary, archive = write(arrays, file), file.getvalue()
    stored = StoredFile(sha256(archive).hexdigest(), len(archive))
    return NewSamples(row_of(stored, summary, now), archive)


def write(arrays: Arrays, file: IO[bytes]) -> dict[str, Any]:
    """Write canonical arrays as an npz; returns a summary of the samples."""
    save_npz(file, arrays)
    values = arrays["values"]
    return {
        "kind": _kind_of(arrays),
        "shape": list(values.shape),
        "min": float(values.min()),
        "max": float(values.max()),
    }


def _kind_of(arrays: Arrays) -> str:
    if "nodes" in arrays:
        return "block_nodes"
    return "scattered" if "points" in arrays else "nodal" if is_nodal(arrays) else "grid"


def convert(
    source: Path, filename: str, target: Path, limits: Limits, *, alone: bool, column: str | None = None
) -> dict[str, Any]:
    """:func:`read` a file, and :func:`write` what it holds."""
    with target.open("wb") as file:
        return write(read(source.read_bytes(), filename, limits, alone=alone, column=column), file)


def field_of(samples: Path | Arrays, box: Box) -> equimesh.Field:
    """A field from canonical samples, which must cover ``box``."""
    return samples_of(_load(samples) if isinstance(samples, Path) else samples, box=box)


def _load(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def canonical_arrays(arrays: dict[str, Any]) -> dict[str, Any]:
    """The arrays as floats of the right dimensions."""
    if "nodes" in arrays:
        found = block_nodes(**arrays)
        return {name: array for name, array in vars(found).items() if array is not None}
    if "points" not in arrays:
        ndim = 2 if is_nodal(arrays) else 1
        axes: dict[str, Any] = {
            name: real_array(arrays[name], name, ndim=ndim) for name in ("x", "y") if name in arrays
        }
        return {**axes, "values": real_array(arrays["values"], "values", ndim=2)}
    points, values = real_array(arrays["points"], "points", ndim=2), real_array(arrays["values"], "values", ndim=1)
    if points.shape[1] != 2:
        raise SamplesError(f"points has shape {points.shape}: it must be (n, 2), one row x, y each", field="points")
    if len(points) != len(values):
        message = f"there are {len(points)} points and {len(values)} values: each point needs one value"
        raise SamplesError(message, field="values")
    if len(points) < MIN_CUBIC:
        raise SamplesError(f"{count_noun(len(points))}: scattered samples need at least {MIN_CUBIC}", field="points")
    return {"points": points, "values": values}


# The kind of the stored samples that are a mesh.
MESH = "mesh"
# The start of the names of the arrays of sides.
_SIDE = "side_"


def convert_mesh(source: Path, filename: str, target: Path, most_points: int) -> dict[str, Any]:
    """Read the mesh in ``source``, write its arrays to an npz file, and return a summary.

    The suffix of ``filename`` tells the format. Raises :class:`~equimesh.errors.InputError` for a mesh that is none of
    quadrilaterals, or that has too many points; its message tells the place in the file, where no pointer leads.
    """
    try:
        return _convert_mesh(source, filename, target, most_points)
    except InputError as error:
        error.field = ""
        raise


def _convert_mesh(source: Path, filename: str, target: Path, most_points: int) -> dict[str, Any]:
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
