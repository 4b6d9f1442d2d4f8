"""preCICE: a mesh of a participant whose vertices are the nodes of a mesh, also while it moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from equimesh_coupling.arrays import finite, real
from equimesh_coupling.errors import BadValues, CouplingError, OldLibrary
from equimesh_coupling.parts import Array, HasParts, MeshParts


class PreciceMesh:
    """The mesh ``name`` of a ``participant`` of preCICE, with the nodes of ``mesh`` as its vertices.

    ``participant`` is a ``precice.Participant`` that is not initialized yet. Where a mapping needs
    cells, it gets triangles. In three dimensions z is 0.

    A solver on a mesh that moves repeats this order. After ``advance`` it reads its data with :meth:`read`, since
    preCICE gives none on a mesh that has just changed. It adapts its mesh, carries what it has read with its own fields
    to the new mesh, and calls :meth:`move`. It solves, calls :meth:`write`, and advances by the whole time window.
    The mesh stays during the iterations of an implicit window, so a checkpoint does not hold it.

    A library that fixes its vertices takes a mesh of the reference domain here, the uniform one, and x and y as data.
    """

    def __init__(self, participant: Any, name: str, mesh: HasParts) -> None:
        self.name = name
        self._participant = participant
        self._parts: MeshParts
        self._vertices: Any
        self._define(mesh)

    def write(self, data: str, values: Any) -> None:
        """Hand over ``values`` at the nodes, of the node shape of the mesh, one more axis for a vector.

        Raises :class:`BadValues` for another shape, and for values that are not finite.
        """
        shape = self._shape_of(data)
        found = finite(real(values, data), data)
        if found.shape != shape:
            raise BadValues(f"{data} has the shape {found.shape}: the mesh {self.name} needs {shape}")
        rows = found.reshape(len(self._parts.points), *shape[len(self._parts.node_shape) :])
        self._participant.write_data(self.name, data, self._vertices, rows)

    def read(self, data: str, after: float = 0.0) -> Array:
        """The values at the nodes, as :meth:`write` takes them, at the time ``after`` the begin of this step.

        preCICE itself refuses it between :meth:`move` and the next ``advance``.
        """
        found = self._participant.read_data(self.name, data, self._vertices, after)
        return np.asarray(found, dtype=np.float64).reshape(self._shape_of(data))

    def move(self, mesh: HasParts) -> None:
        """Replace the vertices by the nodes of ``mesh``, of any number.

        preCICE 3.2 or later allows it in the first step after a complete time window, where its configuration has
        ``<precice-configuration experimental="true" allow-remeshing="true">``. Raises :class:`OldLibrary` for an
        earlier version, and :class:`CouplingError` in any other step.
        """
        if not hasattr(self._participant, "reset_mesh"):
            raise OldLibrary("a mesh that moves needs pyprecice 3.2 or later: pip install 'pyprecice>=3.2'")
        if not self._participant.is_time_window_complete():
            raise CouplingError(
                f"the mesh {self.name} can move in the first step after a complete time window only: call move() "
                "where participant.is_time_window_complete() is true, before the next advance()"
            )
        self._participant.reset_mesh(self.name)
        self._define(mesh)

    def _shape_of(self, data: str) -> tuple[int, ...]:
        """The shape of the values of all nodes: one axis more where ``data`` is a vector."""
        components = self._participant.get_data_dimensions(self.name, data)
        return self._parts.node_shape if components == 1 else (*self._parts.node_shape, components)

    def _define(self, mesh: HasParts) -> None:
        self._parts = parts = mesh.mesh_parts()
        missing = self._participant.get_mesh_dimensions(self.name) - 2
        points = np.pad(parts.points, [(0, 0), (0, missing)])
        self._vertices = np.asarray(self._participant.set_mesh_vertices(self.name, points))
        if self._participant.requires_mesh_connectivity_for(self.name):
            self._participant.set_mesh_triangles(self.name, self._vertices[parts.mesh_parts("triangle").cells])
