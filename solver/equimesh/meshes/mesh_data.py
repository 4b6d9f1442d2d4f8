"""A mesh with values computed on it: the contents of a mesh file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.joined import joined
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, IntArray


def _no_ties() -> IntArray:
    return np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshData:
    """A mesh with values at its nodes and cells.

    ``u`` at the nodes, shape ``(n_xi, n_eta)``, ``None`` where the monitor has no u; per cell, shape
    ``(n_xi - 1, n_eta - 1)``, the measure ``q_eq`` and the number of the ``subdomain`` that computed the cell.
    On a mesh of blocks these shapes are ``(n,)`` and ``(m,)``. ``fields`` are further values at the nodes and
    ``cell_fields`` such values per cell, by names other than those that files have already; a vector has one more axis,
    that of its components. ``ties``, shape ``(k, 2)``, are the nodes of a grid with closed lines that are one: a copy
    and its original. A mesh of blocks has its own. ``step`` is the JSON that a step of a sequence answers with, for npz
    files; it is empty for other meshes.

    Raises :class:`~equimesh.errors.InputError` for other shapes.
    """

    mesh: Mesh | QuadMesh
    u: Array | None
    q_eq: Array
    subdomain: IntArray
    fields: Mapping[str, Array] = field(default_factory=dict)
    cell_fields: Mapping[str, Array] = field(default_factory=dict)
    step: str = ""
    ties: IntArray = field(default_factory=_no_ties)

    def __post_init__(self) -> None:
        nodes, cells = self.mesh.node_shape, self.mesh.cell_shape
        for name, shape in (("u", nodes), ("q_eq", cells), ("subdomain", cells)):
            values = getattr(self, name)
            found = shape if values is None and name == "u" else values.shape
            if found != shape:
                raise InputError(f"{name} has shape {found}, this mesh needs {shape}", field=name)
        for fields, needed in ((self.fields, nodes), (self.cell_fields, cells)):
            for name, values in fields.items():
                if values.shape[: len(needed)] != needed or values.ndim > len(needed) + 1:
                    raise InputError(f"the field {name} has shape {values.shape}, this mesh needs {needed}", field=name)

    @property
    def grid_mesh(self) -> Mesh:
        """The mesh, which must be a grid. Raises :class:`~equimesh.errors.InputError` for a mesh of blocks."""
        if isinstance(self.mesh, QuadMesh):
            raise InputError("this needs a grid, and a mesh of blocks has no rows and columns", field="mesh")
        return self.mesh

    @property
    def joined(self) -> MeshData:
        """The data on a mesh without second copies of nodes at one place; see :func:`~equimesh.meshes.joined.joined`.

        A mesh of blocks has none, and stays as it is.
        """
        if isinstance(self.mesh, QuadMesh):
            return self
        mesh = joined(self.mesh, self.ties)

        def at_nodes(values: Array) -> Array:
            found = np.empty((*mesh.node_shape, *values.shape[2:]))
            found[mesh.blocks[0]] = values
            return found

        return replace(
            self,
            mesh=mesh,
            u=None if self.u is None else at_nodes(self.u),
            q_eq=self.q_eq.ravel(),
            subdomain=self.subdomain.ravel(),
            fields={name: at_nodes(values) for name, values in self.fields.items()},
            cell_fields={name: values.reshape(-1, *values.shape[2:]) for name, values in self.cell_fields.items()},
            ties=_no_ties(),
        )

    @property
    def computational(self) -> tuple[Array, Array]:
        """``xi`` and ``eta`` of the nodes of a grid, each of shape ``(n_xi, n_eta)``.

        Raises :class:`~equimesh.errors.InputError` for a mesh of blocks, which has none.
        """
        uniform = Mesh.uniform(self.grid_mesh.grid)
        return uniform.x, uniform.y

    def triangles(self) -> IntArray:
        """The cells cut into triangles, as :meth:`Mesh.triangles` does it."""
        return self.mesh.triangles()
