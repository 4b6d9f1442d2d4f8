"""The parts of a mesh that other libraries need: points, cells, and the edges of the four sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.errors import BadValues

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Cells: TypeAlias = Literal["quad", "triangle"]

SIDES: Final = ("left", "right", "bottom", "top")
# The number of a side in libraries that know numbers only, and in files: the place in SIDES, from 1.
TAGS: Final = {side: number for number, side in enumerate(SIDES, start=1)}


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshParts:
    """A mesh as plain arrays.

    ``points`` are the coordinates of the nodes, shape ``(n, 2)``, where ``n`` is ``n_xi * n_eta`` and node ``(i, j)``
    has number ``i * n_eta + j``. ``cells`` are counter-clockwise, shape ``(m, 4)`` for quadrilaterals, ``(m, 3)`` for
    triangles; the triangles ``2 k`` and ``2 k + 1`` are cut from quadrilateral ``k``. ``sides`` has the edges of
    ``left``, ``right``, ``bottom`` and ``top``, in this order, shape ``(k, 2)`` each, with the domain on their left.
    ``shape`` is ``(n_xi, n_eta)``.
    """

    points: Array
    cells: IntArray
    sides: Mapping[str, IntArray]
    shape: tuple[int, int]

    @property
    def is_triangular(self) -> bool:
        """Whether the cells are triangles."""
        return bool(self.cells.shape[1] == 3)

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """The parts themselves. Raises :class:`BadValues` where ``cells`` are requested that they do not have."""
        if cells is not None and (cells == "triangle") != self.is_triangular:
            raise BadValues(f"these arrays hold no {cells}s: request the mesh with cells={cells!r}")
        return self


class HasParts(Protocol):
    """A mesh that gives its parts: a mesh of the solver or of the client, or :class:`MeshParts`."""

    def mesh_parts(self, cells: Any = None) -> MeshParts:
        """The parts, with the kind of ``cells`` that is requested, or else the kind that the mesh has."""
        ...
