"""A mesh with values computed on it: the contents of a mesh file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import CurvedEdges
from equimesh.numerics.types import Array, BoolArray, IntArray

# A structured mesh with closed lines as a mesh of quadrilaterals, whose copies of a node are one if they can be.

SEAMS = (("left", "right"), ("bottom", "top"))
"""The sides that are the two copies of a seam, of closed xi-lines and of closed eta-lines."""


def joined(mesh: Mesh) -> Mesh:
    """The mesh without the second copies of nodes that lie where the first ones do, as around a ring.

    Such a seam is no side any more. Copies that lie a period apart stay, with their sides, as the ties of the mesh. A
    mesh of blocks has no others, and is returned itself.
    """
    if not mesh.is_grid:
        return mesh
    points, ties = mesh.points, mesh.ties
    same = at_one_place(points, ties)
    stands = np.arange(len(points))
    stands[ties[same, 0]] = ties[same, 1]
    kept = np.flatnonzero(stands == np.arange(len(points)))
    number = np.zeros(len(points), dtype=np.int64)
    number[kept] = np.arange(kept.size)
    number = number[stands]
    sides = dict(mesh.sides)
    for seam in SEAMS:
        edges = np.sort(number[np.concatenate([sides[name] for name in seam])], axis=1)
        if len(np.unique(edges, axis=0)) < len(edges):
            for name in seam:
                del sides[name]
    return Mesh(
        points=points[kept],
        cells=number[mesh.cells],
        sides={name: number[edges] for name, edges in sides.items()},
        blocks=(number.reshape(mesh.grid.shape),),
        ties=number[ties[~same]],
    )


def at_one_place(points: Array, ties: IntArray) -> BoolArray:
    """Which of the ``ties`` bind two nodes at the same place, shape ``(k,)``."""
    found: BoolArray = (points[ties[:, 0]] == points[ties[:, 1]]).all(axis=1)
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshData:
    """A mesh with values at its nodes and cells.

    ``u`` at the nodes, shape ``(n_xi, n_eta)``, ``None`` where the monitor has no u; per cell, shape ``(n_xi - 1, n_eta
    - 1)``, the measure ``q_eq`` and the number of the ``subdomain`` that computed the cell. On a mesh of blocks these
    shapes are ``(n,)`` and ``(m,)``. ``fields`` are further values at the nodes and ``cell_fields`` such values per
    cell, by names other than those that files have already; a vector has one more axis, that of its components.
    ``curved`` are the edges on curved sides of the domain, for files of second order: ``None``
    where these are straight, or not known. ``step`` is the JSON that a step of a sequence answers with, for npz files;
    it is empty for other meshes.

    Raises :class:`~equimesh.errors.InputError` for other shapes.
    """

    mesh: Mesh
    u: Array | None
    q_eq: Array
    subdomain: IntArray
    fields: Mapping[str, Array] = field(default_factory=dict)
    cell_fields: Mapping[str, Array] = field(default_factory=dict)
    step: str = ""
    curved: CurvedEdges | None = None

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
        if not self.mesh.is_grid:
            raise InputError("this needs a grid, and a mesh of blocks has no rows and columns", field="mesh")
        return self.mesh

    @property
    def joined(self) -> MeshData:
        """The data without second copies of nodes at one place; see :func:`~equimesh.meshes.mesh_data.joined`.

        A mesh of blocks has none, and stays as it is.
        """
        mesh = joined(self.mesh)
        if mesh is self.mesh:
            return self

        def at_nodes(values: Array) -> Array:
            found = np.empty((*mesh.node_shape, *values.shape[2:]))
            found[mesh.blocks[0]] = values
            return found

        curved = self.curved
        return replace(
            self,
            mesh=mesh,
            curved=curved and replace(curved, edges=mesh.blocks[0].ravel()[curved.edges]),
            u=None if self.u is None else at_nodes(self.u),
            q_eq=self.q_eq.ravel(),
            subdomain=self.subdomain.ravel(),
            fields={name: at_nodes(values) for name, values in self.fields.items()},
            cell_fields={name: values.reshape(-1, *values.shape[2:]) for name, values in self.cell_fields.items()},
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
