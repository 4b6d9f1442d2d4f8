"""The text of a Plot3D grid of several blocks, and of the neutral map file that says how they meet."""

from collections.abc import Iterator, Sequence

import numpy as np

from equimesh.io.side_names import words
from equimesh.meshes.interfaces import EDGES, Contact
from equimesh.numerics.types import Array

# Numbers of a row of the grid.
PER_ROW = 3
# The number of each edge of a block among the six faces of a neutral map file, by its place in EDGES.
FACES = dict(enumerate((3, 4, 5, 6)))
# What a neutral map file calls an interface.
INTERFACE = "ONE_TO_ONE"


def plot3d_text(blocks: Sequence[tuple[Array, Array]]) -> str:
    """The grid: the number of blocks, their numbers of nodes, then x, y and z = 0 of each block.

    ``blocks`` are x and y of each, shape ``(n_i, n_j)``; in the file i runs fastest, and each block has one node along
    k. Numbers are written so that they are read back bit for bit.

    Source: P. Walatka et al., PLOT3D user's manual, NASA TM 101067 (1990), chapter 8: formatted, 3D, several blocks.
    """
    lines = [str(len(blocks)), *(f"{x.shape[0]} {x.shape[1]} 1" for x, _ in blocks)]
    for x, y in blocks:
        for values in (x, y, np.zeros(x.shape)):
            lines.extend(_rows([*map(repr, values.T.ravel().tolist())]))
    return "\n".join(lines) + "\n"


def neutral_map(shapes: Sequence[tuple[int, int]], contacts: Sequence[Contact]) -> str:
    """The neutral map file: blocks with their numbers of nodes, interfaces, and edges on sides by the side's name.

    Each line has a block, the number of its face (3 least i, 4 largest i, 5 least j, 6 largest j), and the ranges of
    nodes on it: j and k on the first two faces, k and i on the others. Numbers begin at 1, and k is 1 everywhere. An
    interface goes on with the same of the other block, and TRUE where j of one runs along i of the other.

    Source: NASA Geometry Laboratory, "Neutral Map File Format".
    """
    named = words([contact.side for contact in contacts if contact.side is not None])
    lines = ["# blocks", str(len(shapes)), *(f"{k} {i} {j} 1" for k, (i, j) in enumerate(shapes, start=1))]
    lines.append("# type, block, face, two ranges of nodes; of an interface those of the other block, axes swapped")
    for contact in contacts:
        here = f"{contact.block + 1} {_face(contact.edge, contact.first, contact.last)}"
        if contact.side is not None:
            lines.append(f"'{named[contact.side]}' {here}")
            continue
        there = f"{contact.other + 1} {_face(contact.other_edge, contact.other_first, contact.other_last)}"
        is_swapped = (contact.edge < 2) != (contact.other_edge < 2)
        lines.append(f"'{INTERFACE}' {here} {there} {str(is_swapped).upper()}")
    return "\n".join(lines) + "\n"


def _face(edge: int, first: int, last: int) -> str:
    along, across = f"{first + 1} {last + 1}", "1 1"
    ranges = (along, across) if EDGES[edge].startswith("i") else (across, along)
    return f"{FACES[edge]} {' '.join(ranges)}"


def _rows(numbers: list[str]) -> Iterator[str]:
    return (" ".join(numbers[k : k + PER_ROW]) for k in range(0, len(numbers), PER_ROW))
