"""Uploaded samples: they are read, checked, and made into fields.

To interpolate many scattered samples takes seconds. It is done in a worker, which can be stopped. The linear algebra of
a worker runs on one thread, which is tens of times faster for the many small systems here.

Samples are interpolated once for a mesh, when its request is checked, since only then the domain is known: a small grid
in the process of the service, all others in a side worker. The result goes to the worker that solves
(:class:`~equimesh_service.assembly.problem.PackedProblems`). An upload without a spec is checked as far as that needs
no interpolation (``alone``).
"""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

import equimesh
from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.samples import MIN_CUBIC, checked_grid
from equimesh.inputs import count_noun, real_array
from equimesh.upload.columns import Limits
from equimesh.upload.samples import block_nodes, checked_nodes, is_nodal, read_arrays, samples_of
from equimesh_service.files.port import StoredFile
from equimesh_service.spec.document import check_bounds
from equimesh_service.store.rows import NewSamples, SamplesRow

Arrays: TypeAlias = Mapping[str, Any]
# The most bytes of samples that the service reads itself, also when they are unpacked.
MAX_LIGHT_BYTES = 256 * 1024


def is_light(data: bytes, filename: str) -> bool:
    """Whether a file is read in about a millisecond: npz or npy, and small, also when it is unpacked."""
    if filename.lower().endswith(".npy"):
        return len(data) <= MAX_LIGHT_BYTES
    if not filename.lower().endswith(".npz") or len(data) > MAX_LIGHT_BYTES:
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return sum(entry.file_size for entry in archive.infolist()) <= MAX_LIGHT_BYTES
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        return False  # a worker reports what is wrong


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
    np.savez(file, **arrays)
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
        return {"nodes": found.nodes, "values": found.values}
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


@dataclass(frozen=True)
class Upload:
    """An uploaded file: its bytes, the name whose suffix gives its format, and the name of u among its columns."""

    data: bytes
    filename: str
    column: str | None = None

    @cached_property
    def is_light(self) -> bool:
        """Whether the file is read faster here than in a worker."""
        return is_light(self.data, self.filename)
