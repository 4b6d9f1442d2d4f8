"""Samples at the nodes of a mesh: of a grid x, y and values of one shape, of blocks nodes ``(n, 2)`` and values."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Box
from equimesh.errors import InputError, SamplesError
from equimesh.fields.mesh_map import require_unfolded
from equimesh.fields.nodal_field import NodalField, nodal_values
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array

RIM_SHARE = 0.05
"""The share of the box around a domain with curved sides that the nodes of a mesh may leave out."""


def is_nodal(arrays: Mapping[str, Any]) -> bool:
    """Whether x, y and values are those of the nodes of a mesh, and not axes with a table."""
    return "x" in arrays and np.ndim(arrays["x"]) == 2


def nodal_samples(*, x: Any, y: Any, values: Any, box: Box | None = None) -> NodalField:
    """u from ``values`` at the nodes of a mesh; raises what :func:`checked_nodes` raises."""
    mesh, values = checked_nodes(x=x, y=y, values=values, box=box)
    return NodalField(mesh=mesh, values=values)


def checked_nodes(*, x: Any, y: Any, values: Any, box: Box | None = None) -> tuple[Mesh, Array]:
    """A mesh and ``values`` at its nodes; it must be one of a domain with this ``box``.

    Raises :class:`~equimesh.errors.SamplesError` for other shapes, values that are not finite and another domain, and
    :class:`~equimesh.errors.InputError` for a folded mesh.
    """
    given = {"x": x, "y": y, "values": values}
    x, y, values = (real_array(array, name, ndim=2) for name, array in given.items())
    if not x.shape == y.shape == values.shape:
        shapes = f"{x.shape}, {y.shape} and {values.shape}"
        raise SamplesError(f"the nodes of a mesh have x, y and values of one shape, not {shapes}", field="values")
    for name, line, (low, high) in zip(("x", "y"), (x, y), box or (), strict=False):
        rim = RIM_SHARE * (high - low)
        if abs(line.min() - low) > rim or abs(line.max() - high) > rim:
            raise SamplesError("these are values at the nodes of a mesh of another domain", field=name)
    mesh = Mesh(x, y)
    require_unfolded(mesh)
    return mesh, nodal_values(values, mesh, "values")


NEEDS_BLOCKS = "these are values at the nodes of a mesh of blocks: give the domain of that mesh, which has its cells"
"""Why the nodes of blocks make no function on other domains."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockNodes:
    """``values``, shape ``(n,)``, at the ``nodes``, shape ``(n, 2)``, of a mesh of blocks that is not known yet."""

    nodes: Array
    values: Array

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:  # noqa: ARG002 - a Field
        """Raises :class:`~equimesh.errors.SamplesError`: between nodes only cells tell the values."""
        raise SamplesError(NEEDS_BLOCKS)

    def on(self, blocks: Blocks) -> QuadField:
        """u on the mesh of ``blocks`` with these nodes, in its order.

        Raises :class:`~equimesh.errors.SamplesError` for the nodes of another domain, and
        :class:`~equimesh.errors.InputError` where they make a folded mesh.
        """
        if len(self.nodes) != blocks.points:
            raise SamplesError(f"{len(self.nodes)} nodes: the mesh of this domain has {blocks.points}", field="nodes")
        for line, (low, high) in zip(self.nodes.T, blocks.box, strict=True):
            rim = RIM_SHARE * (high - low)
            if abs(line.min() - low) > rim or abs(line.max() - high) > rim:
                raise SamplesError("these are values at the nodes of a mesh of another domain", field="nodes")
        try:
            return QuadField(mesh=blocks.mesh.moved(self.nodes), values=self.values)
        except InputError as error:
            if error.field == "mesh":
                error.field = "nodes"
            raise


def block_nodes(*, nodes: Any, values: Any) -> BlockNodes:
    """Checked values at the nodes of a mesh of blocks.

    Raises :class:`~equimesh.errors.SamplesError` for other shapes and for numbers that are not finite.
    """
    points, found = real_array(nodes, "nodes", ndim=2), real_array(values, "values", ndim=1)
    if points.shape != (len(found), 2):
        raise SamplesError(
            f"nodes have the shape {points.shape} and values {found.shape}: give a row x, y and a value for each node",
            field="values",
        )
    return BlockNodes(nodes=points, values=found)
