"""What a worker does with samples that come in: read them, and see that a field can be made of them.

Interpolation of scattered samples takes seconds where there are many. A worker can be stopped, and its linear
algebra runs on one thread, which is tens of times faster for the many small systems here.

The same samples are interpolated up to three times. An upload without a spec is interpolated on its own extent, since
faults are to be reported to the sender at once (``alone``). A request for a mesh interpolates them on the domain, which
is known only then; a small grid in the process of the service, all else in a side worker. The solve does so again: it
runs in another process, at another time, and a file is all that outlives both.
"""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import equimesh
from equimesh.domains.domain import Box, Interval
from equimesh.errors import SamplesError
from equimesh.fields.samples import MIN_CUBIC
from equimesh.inputs import count_noun, real_array
from equimesh.upload.samples import read_arrays, samples_of

Arrays: TypeAlias = Mapping[str, Any]
MAX_LIGHT_BYTES = 256 * 1024  # bytes
# The sides of a mesh may leave out this share of the box around a domain with curved sides.
_RIM_SHARE = 0.05


def is_light(data: bytes, filename: str) -> bool:
    """Whether a file is read in about a millisecond: npz or npy, and small when it is unpacked, too."""
    if filename.lower().endswith(".npy"):
        return len(data) <= MAX_LIGHT_BYTES
    if not filename.lower().endswith(".npz") or len(data) > MAX_LIGHT_BYTES:
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return sum(entry.file_size for entry in archive.infolist()) <= MAX_LIGHT_BYTES
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        return False  # a worker will say what is wrong


def read(data: bytes, filename: str, max_bytes: int, *, alone: bool) -> Arrays:
    """The canonical arrays of an upload.

    ``alone`` says that they come without a domain: what is wrong with them on any is then found here, else by who
    makes a field of them. Raises :class:`~equimesh.errors.SamplesError`.
    """
    arrays = _canonical(read_arrays(data, filename, max_bytes=max_bytes))
    if alone and "points" not in arrays:
        samples_of(arrays, box=(_ends(arrays["x"]), _ends(arrays["y"])) if "x" in arrays else None)
    return arrays


def write(arrays: Arrays, target: Path) -> dict[str, Any]:
    """Write canonical arrays as the npz ``target``; returns what the samples are."""
    with target.open("wb") as file:
        np.savez(file, **arrays)
    values = arrays["values"]
    return {
        "kind": "scattered" if "points" in arrays else "grid",
        "shape": list(values.shape),
        "min": float(values.min()),
        "max": float(values.max()),
    }


def convert(source: Path, filename: str, target: Path, max_bytes: int, *, alone: bool) -> dict[str, Any]:
    """:func:`read` a file, and :func:`write` what it holds."""
    return write(read(source.read_bytes(), filename, max_bytes, alone=alone), target)


def field_of(samples: Path | Arrays, box: Box) -> equimesh.Field:
    """A function from canonical samples, stored or as they came, which must cover ``box``."""
    given = _stored(samples) if isinstance(samples, Path) else samples
    if "x" not in given or given["x"].ndim == 1:
        return samples_of(given, box=box)
    for name, (low, high) in zip(("x", "y"), box, strict=True):
        rim = _RIM_SHARE * (high - low)
        if abs(given[name].min() - low) > rim or abs(given[name].max() - high) > rim:
            raise SamplesError("these are values at the nodes of a mesh of another domain", field=name)
    return equimesh.NodalField(mesh=equimesh.Mesh(given["x"], given["y"]), values=given["values"])


def _stored(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def _canonical(arrays: dict[str, Any]) -> dict[str, Any]:
    """The arrays as floats of the right dimensions."""
    if "points" not in arrays:
        axes: dict[str, Any] = {name: real_array(arrays[name], name, ndim=1) for name in ("x", "y") if name in arrays}
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


def _ends(axis: npt.NDArray[np.float64]) -> Interval:
    """The ends of an axis; of one that is to be refused anything."""
    return (float(axis[0]), float(axis[-1])) if axis.size > 1 and axis[0] < axis[-1] else (0.0, 1.0)


@dataclass(frozen=True)
class Upload:
    """A file as it came: its bytes, and the name whose suffix tells its format."""

    data: bytes
    filename: str

    @cached_property
    def is_light(self) -> bool:
        """Whether reading it takes no longer than asking a worker to."""
        return is_light(self.data, self.filename)
