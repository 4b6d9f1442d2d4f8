"""Samples at the nodes of a mesh: of a grid x, y and values of one shape, of blocks nodes ``(n, 2)`` and values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Box
from equimesh.errors import InputError, SamplesError
from equimesh.fields.mesh_map import require_unfolded
from equimesh.fields.nodal_field import NodalField, nodal_values
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import ValueDegree, lattice_of, nodes_of_elements
from equimesh.numerics.types import Array, IntArray

RIM_SHARE = 0.05
"""The share of the box around a domain with curved sides that the nodes of a mesh may leave out."""
OF_BLOCKS = "block_cells"
"""The key of the cells of each block, of a mesh with other cells than the domain."""


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
    return mesh, nodal_values(values, mesh)


NEEDS_BLOCKS = "these are values at the nodes of a mesh of blocks: give the domain of that mesh, which has its cells"
"""Why the nodes of blocks make no function on other domains."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockNodes:
    """``values``, shape ``(n,)``, at the ``nodes``, shape ``(n, 2)``, of a mesh of blocks that is not known yet.

    ``block_cells`` are its numbers of cells along i and j of each block, shape ``(b, 2)``; ``None``: as in the domain.
    """

    nodes: Array
    values: Array
    block_cells: IntArray | None = None

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:  # noqa: ARG002 - a Field
        """Raises :class:`~equimesh.errors.SamplesError`: between nodes only cells tell the values."""
        raise SamplesError(NEEDS_BLOCKS)

    def on(self, blocks: Blocks) -> QuadField:
        """u on the mesh of ``blocks`` with these nodes, in its order.

        Raises :class:`~equimesh.errors.SamplesError` for the nodes of another domain, and
        :class:`~equimesh.errors.InputError` where they make a folded mesh.
        """
        if self.block_cells is not None:
            blocks = with_cells(blocks, self.block_cells, len(self.nodes))
        counts = {degree: nodes_of_elements(blocks.mesh, degree)[0] for degree in get_args(ValueDegree)}
        degree = next((degree for degree, count in counts.items() if count == len(self.nodes)), None)
        if degree is None:
            first, *others = map(str, counts.values())
            raise SamplesError(
                f"{len(self.nodes)} nodes: the mesh of this domain has {first}, and {', '.join(others)} those of"
                " elements of degree 2, 3 and 4",
                field="nodes",
            )
        mesh = blocks.mesh if degree == 1 else lattice_of(blocks.mesh, degree)
        for line, (low, high) in zip(self.nodes.T, blocks.box, strict=True):
            rim = RIM_SHARE * (high - low)
            if abs(line.min() - low) > rim or abs(line.max() - high) > rim:
                raise SamplesError("these are values at the nodes of a mesh of another domain", field="nodes")
        try:
            return QuadField(mesh=mesh.moved(self.nodes), values=self.values)
        except InputError as error:
            if error.field == "mesh":
                error.field = "nodes"
            raise


def with_cells(blocks: Blocks, block_cells: Any, most: int) -> Blocks:
    """The blocks with these numbers of cells along i and j of each, shape ``(b, 2)``, and at most so many nodes.

    Raises :class:`~equimesh.errors.SamplesError` for others than the blocks can have.
    """
    wanted = _counts(block_cells, most)
    is_one_each = wanted.shape == (blocks.layout.block_count, 2)
    counts = blocks.layout.counts_of([(i + 1, j + 1) for i, j in wanted]) if is_one_each else None
    if counts is None:
        raise SamplesError(
            f"block_cells are two whole numbers for each of {blocks.layout.block_count} blocks, along i and along j,"
            " equal at common edges: send those of the mesh of the values",
            field=OF_BLOCKS,
        )
    if (needed := blocks.layout.with_counts(counts).node_count) > most:
        raise SamplesError(f"a mesh of these cells has {needed} nodes, and there are {most}", field=OF_BLOCKS)
    return blocks if np.array_equal(counts, blocks.layout.counts) else blocks.with_counts(counts)


def _counts(block_cells: Any, most: int) -> IntArray:
    found = real_array(block_cells, OF_BLOCKS, ndim=2)
    if not bool(((found >= 1) & (found <= most) & (np.floor(found) == found)).all()):
        raise SamplesError(
            f"block_cells are whole numbers from 1 to {most}, which is the number of nodes: send those of the mesh of"
            " the values",
            field=OF_BLOCKS,
        )
    return found.astype(np.int64)


def block_nodes(*, nodes: Any, values: Any, block_cells: Any = None) -> BlockNodes:
    """Checked values at the nodes of a mesh of blocks, which has the cells of the domain unless they are given.

    Raises :class:`~equimesh.errors.SamplesError` for other shapes and for numbers that are not finite.
    """
    points, found = real_array(nodes, "nodes", ndim=2), real_array(values, "values", ndim=1)
    if points.shape != (len(found), 2):
        raise SamplesError(
            f"nodes have the shape {points.shape} and values {found.shape}: give a row x, y and a value for each node",
            field="values",
        )
    cells = None if block_cells is None else _counts(block_cells, len(found))
    return BlockNodes(nodes=points, values=found, block_cells=cells)
