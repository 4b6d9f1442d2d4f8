"""What lies between two times: u, and the mesh."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
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
