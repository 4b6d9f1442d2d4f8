"""The text of an SU2 mesh file."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.io.side_names import words
from equimesh.numerics.types import Array

IntArray: TypeAlias = npt.NDArray[np.integer[Any]]

LINE, TRIANGLE, QUADRILATERAL = 3, 5, 9  # VTK's numbers of the element types, which SU2 uses


def su2_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray]) -> str:
    """The file's text: the cells, the points, and a marker with the edges of each side.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, counter-clockwise as SU2 needs them, each side
    ``(k, 2)``; numbering starts at 0, as in the file. Names of sides get ``_`` for spaces, which SU2 does not read.
    """
    shape = TRIANGLE if cells.shape[1] == 3 else QUADRILATERAL
    lines = ["NDIME= 2", f"NELEM= {len(cells)}", *_elements(shape, cells), f"NPOIN= {len(points)}"]
    lines += [f"{x!r} {y!r} {number}" for number, (x, y) in enumerate(points.tolist())]
    lines.append(f"NMARK= {len(sides)}")
    named = words(sides)
    for name, edges in sides.items():
        lines += [f"MARKER_TAG= {named[name]}", f"MARKER_ELEMS= {len(edges)}"]
        lines += [f"{LINE} {a} {b}" for a, b in edges.tolist()]
    return "\n".join(lines) + "\n"


def _elements(shape: int, cells: IntArray) -> list[str]:
    rows = enumerate(cells.tolist())
    return [f"{shape} {' '.join(map(str, nodes))} {number}" for number, nodes in rows]
