"""Interpolation between two times: of u, and of the mesh."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.blocks.blocks import Blocks
from equimesh.fields.field import Field
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array

# Times, at most, that the share of the mesh before is halved until no cell is folded.
MAX_HALVINGS = 4


@dataclass(frozen=True, kw_only=True)
class Between:
    """``(1 - share) * earlier + share * later``: a function of x and y between two times, by linear interpolation.

    Implements :class:`~equimesh.fields.field.Field`.
    """

    earlier: Field
    later: Field
    share: float

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its derivatives, as ``Field.evaluate``."""
        pairs = zip(self.earlier.evaluate(x, y, order), self.later.evaluate(x, y, order), strict=True)
        return tuple((1.0 - self.share) * one + self.share * other for one, other in pairs)


def mesh_between(before: Mesh, new: Mesh, share: float) -> Mesh:
    """The ``new`` mesh of the reference square, with a ``share`` of the positions in the mesh ``before``.

    Where such a mesh is folded, the share is halved, and at last the new mesh is the result.
    """
    for _ in range(MAX_HALVINGS):
        mesh = Mesh(new.x + share * (before.x - new.x), new.y + share * (before.y - new.y))
        if not mesh.is_folded:
            return Mesh.of_unit_square(mesh.x, mesh.y)
        share *= 0.5
    return new


def blocks_between(domain: Blocks, before: QuadMesh, new: QuadMesh, share: float) -> QuadMesh:
    """The mesh between two meshes of a ``domain`` in blocks; nodes on curves are at their nearest points."""
    finest = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    for _ in range(MAX_HALVINGS):
        place = finest.of_points(new.points + share * (before.points - new.points))
        mesh = place.quad_mesh(domain.mesh)
        if not mesh.is_folded:
            return mesh
        share *= 0.5
    return new
