"""Samples of a function of x and y in the forms that people have, as named arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.errors import BadValues

Array: TypeAlias = npt.NDArray[np.float64]
Box: TypeAlias = tuple[tuple[float, float], tuple[float, float]]
UNIT_BOX: Box = ((0.0, 1.0), (0.0, 1.0))
N_SAMPLES = 129
"""Points a direction at which a callable is sampled."""


def pieces_of(u: object, box: Box = UNIT_BOX, n_samples: int = N_SAMPLES) -> dict[str, Array]:
    """The named arrays of samples, which have one of the kinds of :func:`kind_of`.

    ``u`` is a 2-D array or list of values on the uniform grid of the ``box``, first index along x; ``(x, y, values)``
    or a mapping with these keys: a rectilinear grid when ``values`` is 2-D, scattered points when all three are 1-D,
    the nodes of a mesh when all three are 2-D; scattered ``(points, values)`` or such a mapping; a mapping with
    ``nodes`` of shape ``(n, 2)`` and ``values``, those of a mesh of blocks, with ``block_cells`` of shape ``(b, 2)``
    where it has other cells than the domain; or a callable ``u(x, y)``, called once with arrays of shape
    ``(n_samples, n_samples)``.

    Raises :class:`~equimesh_coupling.errors.BadValues` when ``u`` is none of these, or has a value that is not finite.
    """
    return sample(u, n_samples, box) if callable(u) else _pieces(u, box)


def kind_of(pieces: Mapping[str, Array]) -> str:
    """The key of samples in a spec: ``grid``, ``nodal``, ``scattered`` or ``block_nodes``."""
    if "nodes" in pieces:
        return "block_nodes"
    return "scattered" if "points" in pieces else "nodal" if pieces["x"].ndim == 2 else "grid"


def sample(u: Callable[[Array, Array], object], n_samples: int = N_SAMPLES, box: Box = UNIT_BOX) -> dict[str, Array]:
    """Values of a callable on the uniform ``n_samples`` x ``n_samples`` grid of the box.

    Raises :class:`BadValues` when the callable does not work on arrays.
    """
    if n_samples < 2:
        raise BadValues(f"n_samples = {n_samples}: at least 2 points a side are needed to sample u")
    axes = [np.linspace(*ends, n_samples) for ends in box]
    x, y = np.meshgrid(*axes, indexing="ij")
    try:
        returned = u(x, y)
        if returned is None:
            raise BadValues("u(x, y) is None: it has to return its values")
        values = _array("u(x, y)", returned)
        values = np.ascontiguousarray(np.broadcast_to(values, x.shape))
    except BadValues:
        raise
    except (TypeError, ValueError) as error:
        raise BadValues(
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
        if {"nodes", "values"} <= keys <= {"nodes", "values", "block_cells"}:
            cells = {name: _whole(name, u[name]) for name in keys & {"block_cells"}}
            return _at_nodes(_array("nodes", u["nodes"]), _array("values", u["values"])) | cells
        raise BadValues(
            f"samples have the keys x, y, values, or points, values, or nodes, values; not {', '.join(map(str, u))}"
        )
    if isinstance(u, tuple):
        if len(u) == 3:
            return _three(*u)
        if len(u) == 2:
            return _check_finite({"points": _array("points", u[0]), "values": _array("values", u[1])})
        raise BadValues(f"a tuple of samples is (x, y, values) or (points, values), not {len(u)} items")
    if not isinstance(u, np.ndarray | list):
        raise BadValues(
            f"u is an expression, an array, a tuple (x, y, values) or (points, values), or a callable; not {u!r:.80}"
        )
    values = _array("u", u)
    if values.ndim != 2:
        raise BadValues(f"an array u has two dimensions, values[i, j] at (x_i, y_j); this one has {values.ndim}")
    if min(values.shape) < 2:
        raise BadValues(f"an array u needs at least 2 values in each direction; this one is {values.shape}")
    if values.shape[1] == 3 and len(values) > 3:
        raise BadValues(
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
            raise BadValues(f"x, y and values at the nodes of a mesh have one common shape, not {shapes}")
        return _check_finite(pieces)
    if pieces["x"].ndim != 1 or pieces["y"].ndim != 1:
        raise BadValues("x and y are the two axes, with one dimension each; values[i, j] belongs to (x[i], y[j])")
    if pieces["values"].ndim == 1:
        if not pieces["x"].size == pieces["y"].size == pieces["values"].size:
            raise BadValues("scattered x, y and values have one common length; a grid has 2-D values")
        points = np.column_stack([pieces["x"], pieces["y"]])
        return _check_finite({"points": points, "values": pieces["values"]})
    return _check_finite(pieces)


def _at_nodes(nodes: Array, values: Array) -> dict[str, Array]:
    """Values at the nodes of a mesh of blocks."""
    if nodes.shape != (values.size, 2) or values.ndim != 1:
        raise BadValues(f"nodes of shape (n, 2) have values of shape (n,), not {nodes.shape} and {values.shape}")
    return _check_finite({"nodes": nodes, "values": values})


def _whole(name: str, value: object) -> npt.NDArray[Any]:
    """An array of whole numbers."""
    given = _array(name, value)
    if not (np.isfinite(given).all() and np.array_equal(given, np.floor(given)) and (np.abs(given) < 2**63).all()):
        raise BadValues(f"{name} are numbers of cells along both directions of every block: give whole numbers")
    return given.astype(np.int64)


def _array(name: str, value: object) -> Array:
    if np.ma.is_masked(value):
        raise BadValues(f"{name} has masked values; give the rest as scattered points")
    try:
        array = np.asarray(value)
        if not np.iscomplexobj(array):
            return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise BadValues(f"{name} is not an array of real numbers: {error}") from error
    raise BadValues(f"{name} is not an array of real numbers: it is complex")


def _check_finite(pieces: dict[str, Array]) -> dict[str, Array]:
    """The pieces; raises :class:`BadValues` for a value that is not finite."""
    for name, array in pieces.items():
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            index = ", ".join(str(i) for i in bad[0])
            raise BadValues(f"{name}[{index}] is {array[tuple(bad[0])]}; samples must be finite ({len(bad)} are not)")
    return pieces
