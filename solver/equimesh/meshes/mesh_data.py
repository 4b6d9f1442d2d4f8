"""A mesh with values computed on it: the contents of a mesh file."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.cuts import CUTS, better_cuts, corner_cuts
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshData:
    """A mesh with values at its nodes and cells.

    ``u`` at the nodes, shape ``(n_xi, n_eta)``, ``None`` where the monitor has no u; per cell, shape
    ``(n_xi - 1, n_eta - 1)``, the measure ``q_eq`` and the number of the ``subdomain`` that computed the cell.
    ``fields`` are further values at the nodes, by names other than those that files have already.

    Raises :class:`~equimesh.errors.InputError` for other shapes.
    """

    mesh: Mesh
    u: Array | None
    q_eq: Array
    subdomain: IntArray
    fields: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n_xi, n_eta = nodes = self.mesh.x.shape
        for name, shape in (
            ("u", nodes),
            ("q_eq", (n_xi - 1, n_eta - 1)),
            ("subdomain", (n_xi - 1, n_eta - 1)),
        ):
            values = getattr(self, name)
            found = shape if values is None and name == "u" else values.shape
            if found != shape:
                raise InputError(f"{name} has shape {found}, this mesh needs {shape}", field=name)
        for name, values in self.fields.items():
            if values.shape != nodes:
                raise InputError(f"the field {name} has shape {values.shape}, this mesh needs {nodes}", field=name)

    @property
    def computational(self) -> tuple[Array, Array]:
        """``xi`` and ``eta`` of the nodes, each of shape ``(n_xi, n_eta)``."""
        uniform = Mesh.uniform(self.mesh.grid)
        return uniform.x, uniform.y

    def triangles(self) -> IntArray:
        """The cells cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

        Cell ``k`` gives the rows ``2 k`` and ``2 k + 1``. Each quadrilateral is cut along the diagonal that
        leaves the larger smallest angle. An inverted triangle has a negative angle, so a cut with two positive
        triangles is taken wherever there is one. The four cells at the corners are cut through the corner, so that
        no triangle has two edges on the boundary.
        """
        cuts = better_cuts(self.mesh.points[self.mesh.cells], corner_cuts(self.q_eq.shape))
        corners = CUTS[cuts].reshape(-1, 6)
        triangles: IntArray = np.take_along_axis(self.mesh.cells, corners, axis=1)
        return triangles.reshape(-1, 3)
