"""The outcome of a request, as an exception or as a mesh of another library."""

import importlib
from typing import Any

import numpy as np

from equimesh_client.errors import BadArgument, MeshCanceled, MeshFailed
from equimesh_client.records.measures import Array
from equimesh_client.records.resources import MeshState
from equimesh_client.wire.arrays import MeshArrays


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
    sides = list(arrays.boundary.items())
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
