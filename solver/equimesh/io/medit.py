"""The text of a Medit mesh file (INRIA), as FreeFEM and Mmg read it."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.numerics.types import Array

IntArray: TypeAlias = npt.NDArray[np.integer[Any]]


def medit_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray], *, subdomain: IntArray) -> str:
    """The file's text: points, the edges of the sides with the references 1, 2, ... in their order, and the cells.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, each side ``(k, 2)``; numbering starts at 0,
    and at 1 in the file. The reference of a cell is the number of its ``subdomain``, from 1; that of a point is that of
    the last side it lies on, 0 inside.
    """
    edges = np.concatenate(list(sides.values())) + 1
    labels = np.repeat(np.arange(1, len(sides) + 1), [len(side) for side in sides.values()])
    references = np.zeros(len(points), dtype=np.int64)
    for number, side in enumerate(sides.values(), start=1):
        references[side.ravel()] = number
    places = zip(points.tolist(), references.tolist(), strict=True)
    lines = ["MeshVersionFormatted 2", "Dimension 2", "Vertices", str(len(points))]
    lines += [f"{x!r} {y!r} {reference}" for (x, y), reference in places]
    lines += ["Edges", str(len(edges)), *_rows(edges, labels)]
    lines += ["Triangles" if cells.shape[1] == 3 else "Quadrilaterals", str(len(cells))]
    lines += [*_rows(cells + 1, subdomain + 1), "End"]
    return "\n".join(lines) + "\n"


def _rows(nodes: IntArray, references: IntArray) -> list[str]:
    return [" ".join(map(str, row)) for row in np.column_stack([nodes, references]).tolist()]
