"""The arrays and pictures of a mesh as the service sends them, and a failed mesh as an exception."""

from __future__ import annotations

import importlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from equimesh_client.errors import BadArgument, DownloadDamaged, MeshCanceled, MeshFailed
from equimesh_client.records.measures import Array, IntArray
from equimesh_client.records.resources import MeshState
from equimesh_client.wire.downloads import write_atomically
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import SIDES, Cells, MeshParts
from equimesh_schema import Certificate


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshArrays(Coupled):
    """The arrays of a mesh.

    ``x``, ``y`` and ``u`` have shape ``(n_xi, n_eta)``; ``u`` is None where the monitor has none. ``cells`` are
    counter-clockwise, of shape ``(m, 4)``, or ``(m, 3)`` for triangles. ``q_eq`` and ``subdomain`` belong to the
    quadrilaterals, shape ``(n_xi - 1, n_eta - 1)``; two successive triangles share one. ``boundary`` holds the edges
    ``(k, 2)`` of each side, with the domain on their left.

    A step of a sequence has ``fields`` at nodes or in cells, the ``velocity`` of its nodes, which is their displacement
    since the step before, of shape ``(n_xi, n_eta, 2)``, and ``step``, the JSON that the service says of it. Other
    meshes have no fields, None, and an empty mapping.

    A mesh of blocks has ``x``, ``y`` and ``u`` of shape ``(n,)``, ``q_eq`` and ``subdomain`` of shape ``(m,)``, where
    ``subdomain`` is the number of the block, and in ``boundary`` the sides by their names. ``blocks`` are the nodes of
    each block, of shape ``(n_i, n_j)``, by its name; ``ties`` are nodes that are one unknown, a copy and its original,
    of shape ``(k, 2)``. A grid has no blocks, and ties where its lines are closed; without ties they are None.

    A mesh that the service does not keep has its ``certificate`` here; that of others is ``mesh.certificate``.
    """

    x: Array
    y: Array
    u: Array | None
    cells: IntArray
    q_eq: Array
    subdomain: IntArray
    boundary: Mapping[str, IntArray]
    fields: Mapping[str, Array] = field(default_factory=dict)
    velocity: Array | None = None
    step: Mapping[str, Any] = field(default_factory=dict)
    blocks: Mapping[str, IntArray] = field(default_factory=dict)
    ties: IntArray | None = None
    certificate: Certificate | None = None

    @cached_property
    def points(self) -> Array:
        """Node coordinates, shape ``(n, 2)``, where n is ``n_xi * n_eta`` for a grid."""
        return np.column_stack([self.x.ravel(), self.y.ravel()])

    @property
    def sides(self) -> Mapping[str, IntArray]:
        """The edges of each side, as in ``boundary``: ``equimesh`` has this name alone."""
        return self.boundary

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """Points, cells and sides for other libraries; ``cells`` as requested, or else as they are."""
        shape = (self.x.shape[0], self.x.shape[1]) if self.x.ndim == 2 else None
        return MeshParts(points=self.points, cells=self.cells, sides=self.sides, shape=shape).mesh_parts(cells)


# What the names of the arrays of sides and of blocks begin with in the file of a mesh of blocks.
SIDE, BLOCK = "sides/", "blocks/"
# The array of nodes that are one unknown.
TIES = "ties/nodes"
STEP = "step_json"
"""The array with the bytes of the JSON of a step."""
KNOWN = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", STEP, TIES, *SIDES})


def arrays_of(npz: bytes) -> MeshArrays:
    """The arrays of an npz mesh file. Raises :class:`DownloadDamaged` when it is not one."""
    try:
        with np.load(io.BytesIO(npz), allow_pickle=False) as file:
            is_grid = file["x"].ndim == 2
            if file["y"].shape != file["x"].shape:
                raise ValueError("x and y have different shapes")
            every = 2 if file["cells"].shape[1] == 3 else 1
            shape = tuple(n - 1 for n in file["x"].shape) if is_grid else (len(file["cells"]) // every,)
            step = json.loads(file[STEP].tobytes()) if STEP in file.files else {}
            velocity = step.get("velocity")  # its name among the arrays
            return MeshArrays(
                x=file["x"],
                y=file["y"],
                u=file.get("u"),
                cells=file["cells"].astype(np.int64),
                q_eq=file["q_eq"].ravel()[::every].reshape(shape),
                subdomain=file["subdomain"].ravel()[::every].reshape(shape).astype(np.int64),
                boundary={side: file[side].astype(np.int64) for side in SIDES} if is_grid else _named(file, SIDE),
                fields={name: file[name] for name in file.files if _is_field(name, velocity)},
                velocity=None if velocity is None else file[velocity],
                step=step,
                blocks=_named(file, BLOCK),
                ties=file[TIES].astype(np.int64) if TIES in file.files else None,
            )
    except (KeyError, ValueError, OSError, EOFError, IndexError, zipfile.BadZipFile) as error:
        raise DownloadDamaged(f"the npz file of the mesh cannot be read: {error}") from error


def _named(file: Any, start: str) -> dict[str, IntArray]:
    """The arrays whose names begin with ``start``, by the rest of their names."""
    return {name.removeprefix(start): file[name].astype(np.int64) for name in file.files if name.startswith(start)}


def _is_field(name: str, velocity: str | None) -> bool:
    """Whether an array of a mesh file is a field of a step."""
    return name not in KNOWN and name != velocity and not name.startswith((SIDE, BLOCK))


def raise_unless_succeeded(mesh: MeshState) -> None:
    """Raise :class:`MeshFailed` or :class:`MeshCanceled` for a finished mesh that did not succeed."""
    if mesh.status == "failed":
        raise MeshFailed(mesh, mesh.error or {})
    if mesh.status == "canceled":
        raise MeshCanceled(mesh)


def meshio_mesh(arrays: MeshArrays) -> Any:
    """A ``meshio.Mesh`` of the cells and named boundary lines, with the data that the files have.

    Raises :class:`BadArgument` when meshio is not installed.
    """
    try:
        # By name: the client must not depend on meshio, which import-linter checks.
        meshio = importlib.import_module("meshio")
    except ImportError as error:
        raise BadArgument("to_meshio() needs meshio, which is not installed: pip install meshio") from error
    sides = list(arrays.sides.items())
    empty = np.zeros(0, dtype=np.int64)
    kind, parts = ("triangle", 2) if arrays.cells.shape[1] == 3 else ("quad", 1)
    of_cells = {"Q_eq": (arrays.q_eq, np.nan), "subdomain": (arrays.subdomain, -1)}  # each with its value on sides
    return meshio.Mesh(
        arrays.points,
        [(kind, arrays.cells), *(("line", edges) for _, edges in sides)],
        point_data={**({} if arrays.u is None else {"u": arrays.u.ravel()}), **_reference(arrays)},
        cell_data={
            name: [np.repeat(values.ravel(), parts), *(np.full(len(edges), none) for _, edges in sides)]
            for name, (values, none) in of_cells.items()
        },
        cell_sets={
            name: [np.arange(len(edges)) if block == place else empty for block in range(len(sides) + 1)]
            for place, (name, edges) in enumerate(sides, start=1)
        },
    )


def _reference(arrays: MeshArrays) -> dict[str, Array]:
    """The coordinates ``xi`` and ``eta`` of the nodes of a grid; blocks have none."""
    if arrays.x.ndim == 1:
        return {}
    xi, eta = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in arrays.x.shape), indexing="ij")
    return {"xi": xi.ravel(), "eta": eta.ravel()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A mesh as the service draws it: its nodes, and the error of every cell, None where there is no u.

    Of a grid ``x`` and ``y`` have shape ``(n_xi, n_eta)``. Of blocks all arrays are flat, block by block, and
    ``blocks`` has the places of the nodes of each.
    """

    x: Array
    y: Array
    error: Array | None
    blocks: tuple[IntArray, ...] = ()

    @property
    def points(self) -> Array:
        """The nodes in one row, shape ``(n, 2)``."""
        return np.column_stack([self.x.ravel(), self.y.ravel()])


def drawn_of(npz: bytes) -> Drawn:
    """The mesh in a drawing of the service. Raises :class:`DownloadDamaged` when it is not one."""
    try:
        with np.load(io.BytesIO(npz), allow_pickle=False) as file:
            document = json.loads(file["document"].tobytes())
            shapes = [tuple(block["shape"]) for block in document["blocks"] or ()]
            ends = np.cumsum([0, *(n * m for n, m in shapes)])
            places = [np.arange(end - n * m, end).reshape(n, m) for (n, m), end in zip(shapes, ends[1:], strict=True)]
            error = file["error"].astype(np.float64) if "error" in file.files else None
            return Drawn(x=file["x"], y=file["y"], error=error, blocks=tuple(places))
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DownloadDamaged(f"the drawing of the mesh cannot be read: {error}") from error


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A picture: its bytes ``data`` and ``format`` (``svg`` or ``png``). Shows itself in a notebook."""

    data: bytes = field(repr=False)
    format: str

    def save(self, path: str | Path) -> Path:
        """Write the picture to ``path`` and return it. The suffix does not change the format."""
        return write_atomically(path, self.data)

    def _repr_svg_(self) -> str | None:
        return self.data.decode() if self.format == "svg" else None

    def _repr_png_(self) -> bytes | None:
        return self.data if self.format == "png" else None


def plot_format(path: str | Path | None, format: str | None) -> str:
    """``format``, or that of the suffix of ``path``, or svg."""
    if format is not None:
        return format
    suffix = Path(path).suffix.lower().lstrip(".") if path is not None else ""
    return suffix or "svg"
