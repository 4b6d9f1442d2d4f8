"""Functions of x and y as the JSON of a spec: expressions, samples, callables and files."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import UNIT_BOX, Box

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
    n_samples: int = 129,
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
            expression["parameters"] = {name: float(value) for name, value in parameters.items()}
        if t is not None:
            expression["t"] = float(t)
        return Source(json=expression)
    if parameters or t is not None:
        raise BadArgument("parameters and t belong to an expression; u is not a string here")
    if isinstance(u, StoredSamples):
        return Source(json={"samples": u.id})
    if isinstance(u, Path | SampleFile):
        return Source(json={"samples": "upload"}, upload=read_upload(u))
    if callable(u):
        return _samples(sample(u, n_samples, box))
    return _samples(_pieces(u, box))


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


def upload_of(u: object, *, n_samples: int = 129, box: Box = UNIT_BOX) -> Upload:
    """Samples of any kind that :func:`source_of` accepts, as a file to upload."""
    if isinstance(u, Upload):
        return u
    if isinstance(u, Path | SampleFile):
        return read_upload(u)
    if isinstance(u, str):
        raise BadArgument("an expression is not samples; give a pathlib.Path to upload a file")
    return _npz(sample(u, n_samples, box) if callable(u) else _pieces(u, box))


def sample(u: Callable[[Array, Array], object], n_samples: int, box: Box = UNIT_BOX) -> dict[str, Array]:
    """Values of a callable on the uniform ``n_samples`` x ``n_samples`` grid of the box.

    Raises :class:`BadArgument` when the callable does not work on arrays.
    """
    if n_samples < 2:
        raise BadArgument(f"n_samples = {n_samples}: at least 2 points a side are needed to sample u")
    axes = [np.linspace(*ends, n_samples) for ends in box]
    x, y = np.meshgrid(*axes, indexing="ij")
    try:
        values = _array("u(x, y)", u(x, y))
        values = np.ascontiguousarray(np.broadcast_to(values, x.shape))
    except BadArgument:
        raise
    except (TypeError, ValueError) as error:
        raise BadArgument(
            f"u(x, y) must take arrays and return an array of their shape; it ended with: {error}. "
            "Use numpy's functions inside it, or wrap it in numpy.vectorize"
        ) from error
    return _check_finite({"x": axes[0], "y": axes[1], "values": values})


def _pieces(u: object, box: Box) -> dict[str, Array]:
    """The named arrays of samples given as an array, a tuple or a mapping."""
    if isinstance(u, Mapping):
        keys = set(u)
        if keys == {"x", "y", "values"}:
            return _three(u["x"], u["y"], u["values"])
        if keys == {"points", "values"}:
            return _check_finite({"points": _array("points", u["points"]), "values": _array("values", u["values"])})
        if keys == {"nodes", "values"}:
            return _at_nodes(_array("nodes", u["nodes"]), _array("values", u["values"]))
        raise BadArgument(
            f"samples have the keys x, y, values, or points, values, or nodes, values; not {', '.join(map(str, u))}"
        )
    if isinstance(u, tuple):
        if len(u) == 3:
            return _three(*u)
        if len(u) == 2:
            return _check_finite({"points": _array("points", u[0]), "values": _array("values", u[1])})
        raise BadArgument(f"a tuple of samples is (x, y, values) or (points, values), not {len(u)} items")
    if not isinstance(u, np.ndarray | list):
        raise BadArgument(
            f"u is an expression, an array, a tuple (x, y, values) or (points, values), or a callable; not {u!r:.80}"
        )
    values = _array("u", u)
    if values.ndim != 2:
        raise BadArgument(f"an array u has two dimensions, values[i, j] at (x_i, y_j); this one has {values.ndim}")
    if min(values.shape) < 2:
        raise BadArgument(f"an array u needs at least 2 values in each direction; this one is {values.shape}")
    if values.shape[1] == 3 and len(values) > 3:
        raise BadArgument(
            f"an array of shape {values.shape} looks like a table of x, y and u: give (table[:, :2], table[:, 2]). "
            "If it is values on a grid with 3 points in y, give (x, y, values)"
        )
    axes = [np.linspace(*ends, count) for ends, count in zip(box, values.shape, strict=True)]
    return _check_finite({"x": axes[0], "y": axes[1], "values": values})


def _three(x: object, y: object, values: object) -> dict[str, Array]:
    """A rectilinear grid when the values are 2-D, points when everything is 1-D, nodes of a mesh when it is 2-D."""
    pieces = {"x": _array("x", x), "y": _array("y", y), "values": _array("values", values)}
    if pieces["x"].ndim == pieces["y"].ndim == pieces["values"].ndim == 2:
        if not pieces["x"].shape == pieces["y"].shape == pieces["values"].shape:
            shapes = ", ".join(str(piece.shape) for piece in pieces.values())
            raise BadArgument(f"x, y and values at the nodes of a mesh have one common shape, not {shapes}")
        return _check_finite(pieces)
    if pieces["x"].ndim != 1 or pieces["y"].ndim != 1:
        raise BadArgument("x and y are the two axes, with one dimension each; values[i, j] belongs to (x[i], y[j])")
    if pieces["values"].ndim == 1:
        if not pieces["x"].size == pieces["y"].size == pieces["values"].size:
            raise BadArgument("scattered x, y and values have one common length; a grid has 2-D values")
        points = np.column_stack([pieces["x"], pieces["y"]])
        return _check_finite({"points": points, "values": pieces["values"]})
    return _check_finite(pieces)


def _at_nodes(nodes: Array, values: Array) -> dict[str, Array]:
    """Values at the nodes of a mesh of blocks."""
    if nodes.shape != (values.size, 2) or values.ndim != 1:
        raise BadArgument(f"nodes of shape (n, 2) have values of shape (n,), not {nodes.shape} and {values.shape}")
    return _check_finite({"nodes": nodes, "values": values})


def _kind_of(pieces: Mapping[str, Array]) -> str:
    """The key of samples in a spec."""
    if "nodes" in pieces:
        return "block_nodes"
    return "scattered" if "points" in pieces else "nodal" if pieces["x"].ndim == 2 else "grid"


def _array(name: str, value: object) -> Array:
    if np.ma.is_masked(value):
        raise BadArgument(f"{name} has masked values; give the rest as scattered points")
    try:
        array = np.asarray(value)
        if not np.iscomplexobj(array):
            return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise BadArgument(f"{name} is not an array of real numbers: {error}") from error
    raise BadArgument(f"{name} is not an array of real numbers: it is complex")


def _check_finite(pieces: dict[str, Array]) -> dict[str, Array]:
    """The pieces; raises :class:`BadArgument` for a value that is not finite."""
    for name, array in pieces.items():
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            index = ", ".join(str(i) for i in bad[0])
            raise BadArgument(f"{name}[{index}] is {array[tuple(bad[0])]}; samples must be finite ({len(bad)} are not)")
    return pieces


def _samples(pieces: dict[str, Array]) -> Source:
    if sum(array.size for array in pieces.values()) <= MAX_INLINE_VALUES:
        return Source(json={_kind_of(pieces): {name: values.tolist() for name, values in pieces.items()}})
    return Source(json={"samples": "upload"}, upload=_npz(pieces))


def _npz(pieces: dict[str, Array]) -> Upload:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **pieces)
    return Upload(filename="samples.npz", data=file.getvalue(), media_type=MEDIA_TYPES[".npz"])
