"""Functions of x and y as the JSON of a spec: expressions, samples, callables and files."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import BadArgument
from equimesh_coupling.errors import BadValues
from equimesh_coupling.samples import N_SAMPLES, UNIT_BOX, Box, kind_of, pieces_of

Array: TypeAlias = npt.NDArray[np.float64]
MAX_INLINE_VALUES = 2_000
"""Samples of at most this many values are sent as JSON inside the spec, larger ones as an npz file next to it."""
MEDIA_TYPES = {
    ".npz": "application/zip",
    ".npy": "application/octet-stream",
    ".csv": "text/csv",
    ".txt": "text/plain",
    ".json": "application/json",
    ".vtu": "application/octet-stream",
    ".vtk": "application/octet-stream",
}


@dataclass(frozen=True, kw_only=True)
class Upload:
    """A file to send: its name (the suffix gives the format), bytes and media type, and which ``column`` is u."""

    filename: str
    data: bytes
    media_type: str = "application/octet-stream"
    column: str | None = None


@dataclass(frozen=True)
class SampleFile:
    """A file of samples, of which ``column`` is u: a name of a column, array or point data.

    Of a table without a header it is the number of the column, from 1, or ``"matrix"``.
    """

    path: Path | str
    column: str


@dataclass(frozen=True, kw_only=True)
class StoredSamples:
    """Stored samples of the service, from ``client.samples.upload``; ``u`` of any number of meshes."""

    id: str
    record: Mapping[str, Any]

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> StoredSamples:
        """The samples in the JSON of the service."""
        return cls(id=str(record["id"]), record=dict(record))


@dataclass(frozen=True, kw_only=True)
class Source:
    """``u`` of the spec, and the file of samples that are too large for the spec."""

    json: dict[str, Any]
    upload: Upload | None = None


def source_of(
    u: object,
    *,
    parameters: Mapping[str, float] | None = None,
    t: float | None = None,
    n_samples: int = N_SAMPLES,
    box: Box = UNIT_BOX,
) -> Source:
    """The JSON and the file of ``u``, of any kind.

    ``u`` is an expression in x and y (a string); a 2-D array or list of values on the uniform grid of the ``box``,
    first index along x; ``(x, y, values)`` or a mapping with these keys: a rectilinear grid when ``values`` is 2-D,
    scattered points when all three are 1-D, the nodes of a mesh when all three are 2-D; scattered ``(points, values)``
    or such a mapping; a mapping with ``nodes`` of shape ``(n, 2)`` and ``values``, those of a mesh of blocks; a
    callable ``u(x, y)``, called once with arrays of shape ``(n_samples, n_samples)``; a path of a file, or a
    :class:`SampleFile`; or :class:`StoredSamples`. ``parameters`` and ``t`` belong to an expression only.

    Raises :class:`BadArgument` when ``u`` is none of these, or has a value that is not finite.
    """
    if isinstance(u, str):
        if Path(u).suffix.lower() in MEDIA_TYPES:
            raise BadArgument(f"{u!r} looks like the name of a file: give pathlib.Path({u!r})")
        expression: dict[str, Any] = {"expression": u}
        if parameters:
            expression["parameters"] = _numbers(parameters)
        if t is not None:
            expression["t"] = float(t)
        return Source(json=expression)
    if parameters or t is not None:
        raise BadArgument("parameters and t belong to an expression; u is not a string here")
    if isinstance(u, StoredSamples):
        return Source(json={"samples": u.id})
    if isinstance(u, Path | SampleFile):
        return Source(json={"samples": "upload"}, upload=read_upload(u))
    return _samples(_checked(u, box, n_samples))


def _numbers(parameters: object) -> dict[str, float]:
    """The parameters as numbers; raises :class:`BadArgument` for other things."""
    try:
        return {str(name): float(value) for name, value in parameters.items()}  # type: ignore[attr-defined]
    except (AttributeError, TypeError, ValueError):
        raise BadArgument(f'parameters = {parameters!r:.80}: give numbers by their names, as {{"c": 3.0}}') from None


def needs_box(u: object) -> bool:
    """Whether samples of ``u`` depend on the box of the domain: a callable, or an array of values alone."""
    return callable(u) or isinstance(u, np.ndarray | list)


def read_upload(file: str | Path | SampleFile) -> Upload:
    """The ``file`` as an upload; raises :class:`BadArgument` for an unknown suffix or no access."""
    path, column = (Path(file.path), file.column) if isinstance(file, SampleFile) else (Path(file), None)
    if path.suffix.lower() not in MEDIA_TYPES:
        raise BadArgument(f"{path}: samples are read from {', '.join(MEDIA_TYPES)} files")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadArgument(f"{path}: {error.strerror or error}") from error
    return Upload(filename=path.name, data=data, media_type=MEDIA_TYPES[path.suffix.lower()], column=column)


def read_mesh_file(path: str | Path) -> Upload:
    """The mesh file at ``path`` as an upload; raises :class:`BadArgument` where it cannot be read."""
    path = Path(path)
    try:
        return Upload(filename=path.name, data=path.read_bytes())
    except OSError as error:
        raise BadArgument(f"{path}: {error.strerror or error}") from error


def upload_of(u: object, *, n_samples: int = N_SAMPLES, box: Box = UNIT_BOX) -> Upload:
    """Samples of any kind that :func:`source_of` accepts, as a file to upload."""
    if isinstance(u, Upload):
        return u
    if isinstance(u, Path | SampleFile):
        return read_upload(u)
    if isinstance(u, str):
        raise BadArgument("an expression is not samples; give a pathlib.Path to upload a file")
    return _npz(_checked(u, box, n_samples))


def _checked(u: object, box: Box, n_samples: int) -> dict[str, Array]:
    """The named arrays of samples; raises :class:`BadArgument` for other things."""
    try:
        return pieces_of(u, box, n_samples)
    except BadValues as error:
        raise BadArgument(str(error)) from error.__cause__


def _samples(pieces: dict[str, Array]) -> Source:
    if sum(array.size for array in pieces.values()) <= MAX_INLINE_VALUES:
        return Source(json={kind_of(pieces): {name: values.tolist() for name, values in pieces.items()}})
    return Source(json={"samples": "upload"}, upload=_npz(pieces))


def _npz(pieces: dict[str, Array]) -> Upload:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **pieces)
    return Upload(filename="samples.npz", data=file.getvalue(), media_type=MEDIA_TYPES[".npz"])
