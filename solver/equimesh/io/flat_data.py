"""The data of a mesh as files take them: flat arrays by name, in the order of nodes and cells."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from equimesh.io.formats import Cells
from equimesh.meshes.mesh_data import MeshData
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import IntArray

# What the names of the edges of a side begin with in the field data of a vtu file of blocks.
SIDE_DATA: Final = "sides/"


def corners_of(data: MeshData, kind: Cells) -> npt.NDArray[np.int64]:
    """The nodes of the cells of this ``kind``."""
    return data.triangles() if kind == "triangle" else data.mesh.cells


def per_quad(kind: Cells) -> int:
    """How many cells of the file come from one quadrilateral."""
    return 2 if kind == "triangle" else 1


def node_groups(data: MeshData) -> npt.NDArray[np.int32]:
    """SfePy's tag of every node: 0 inside, the number of its side, from 1, and at a corner both numbers, as 13.

    A grid has 1 left, 2 right, 3 bottom, 4 top. With ten sides or more each number has as many digits as the last one.
    """
    groups = np.zeros(data.mesh.x.size, dtype=np.int32)
    shift = 10 ** len(str(len(data.mesh.sides)))
    for number, edges in enumerate(data.mesh.sides.values(), start=1):
        nodes = np.unique(edges)
        groups[nodes] = shift * groups[nodes] + number
    return groups


def side_data(data: MeshData) -> dict[str, IntArray]:
    """The edges of the sides of blocks; a grid has ``xi`` and ``eta`` to find its own."""
    if not isinstance(data.mesh, QuadMesh):
        return {}
    return {f"{SIDE_DATA}{name}": edges.astype(np.int64) for name, edges in data.mesh.sides.items()}


def point_data(data: MeshData) -> dict[str, npt.NDArray[np.float64]]:
    """The data at the nodes by name: u, the fields, and ``xi`` and ``eta`` of a grid."""
    u = {} if data.u is None else {"u": data.u.ravel()}
    found = {**u, **_flat(data.fields, len(data.mesh.node_shape))}
    if isinstance(data.mesh, QuadMesh):
        return found
    xi, eta = data.computational
    return {**found, "xi": xi.ravel(), "eta": eta.ravel()}


def cell_data(data: MeshData, kind: Cells) -> dict[str, npt.NDArray[Any]]:
    """The data in the cells of this ``kind`` by name: ``Q_eq``, ``subdomain`` and the cell fields."""
    # 32 bits: legacy VTK's "long" has another size on Windows
    values: dict[str, npt.NDArray[Any]] = {"Q_eq": data.q_eq, "subdomain": data.subdomain.astype(np.int32)}
    flat = {name: array.ravel() for name, array in values.items()}
    flat |= _flat(data.cell_fields, len(data.mesh.cell_shape))
    return {name: np.repeat(array, per_quad(kind), axis=0) for name, array in flat.items()}


def _flat(fields: Mapping[str, npt.NDArray[np.float64]], axes: int) -> dict[str, npt.NDArray[np.float64]]:
    """Fields as rows of numbers, where the first ``axes`` are those of nodes or cells.

    A vector in the plane gets a third component, since VTK has no others. Vectors of four and more components become
    one field for each, with its number behind the name.
    """
    flat = {}
    for name, values in fields.items():
        rows = values.reshape(math.prod(values.shape[:axes]), -1)
        if values.ndim == axes:
            flat[name] = rows[:, 0]
        elif rows.shape[1] in (2, 3):
            flat[name] = np.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))
        else:
            flat |= {f"{name}_{k}": np.ascontiguousarray(column) for k, column in enumerate(rows.T)}
    return flat
