"""The text of an Abaqus input file with a mesh: p4est, Trixi, deal.II, CalculiX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from equimesh.io.solver_files import integer_rows, labels
from equimesh.numerics.types import Array, IntArray

DOMAIN = "domain"
"""The set of all cells."""
EDGES = "_edges"
"""The end of the name of a surface, after that of its side."""
MAX_NAME = 80
"""Characters of a name, at most: CalculiX refuses longer ones."""
PER_ROW = 10
"""Numbers of a row of a set; Abaqus takes 16."""
CORNERS = {3: 3, 4: 4, 6: 3, 8: 4}
"""The corners of a cell by its nodes."""
MAX_WIDTH = 20
"""Characters that Abaqus and CalculiX read of a number: an exponent behind them would be lost."""


def abaqus_text(points: Array, cells: IntArray, sides: Mapping[str, IntArray], *, subdomain: IntArray) -> str:
    """The file's text: the nodes, the cells, and for each side its nodes and its edges.

    ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 3)`` or ``(m, 4)``, counter-clockwise, each side ``(k, 2)``, with
    the domain on its left; numbering starts at 0, and at 1 in the file. Of second order cells have 6 or 8 nodes, and
    edges 3. Cells are plane elements ``CPS3`` or ``CPS4``, ``CPS6`` or ``CPS8`` of the set ``domain``. The nodes of a
    side are a node set with its name, its edges a surface ``NAME_edges`` of faces of elements: a code that takes an
    edge for one of a side because both nodes are in its set needs the first. Where there are several subdomains, the
    cells of each are the set ``subdomain_1``, and so on. Names of sides that differ only in their case, which readers
    do not see, get a number, as does ``domain``; long ones are cut.

    A coordinate has all its digits, unless these take more than ``MAX_WIDTH`` characters.

    Source: Abaqus, "Keywords reference": NODE, ELEMENT, NSET, ELSET, SURFACE.
    """
    nodes = cells.shape[1]
    named = labels(sides, [DOMAIN], MAX_NAME - len(EDGES))
    lines = ["*HEADING", " equimesh", "*NODE"]
    lines += [f"{k}, {number(x)}, {number(y)}, 0.0" for k, (x, y) in enumerate(points.tolist(), start=1)]
    lines.append(f"*ELEMENT, type=CPS{nodes}, ELSET={DOMAIN}")
    numbered = np.column_stack([np.arange(1, len(cells) + 1), cells + 1])
    lines += integer_rows(", ".join(["%d"] * (nodes + 1)), numbered)
    for side, edges in sides.items():
        lines += [f"*NSET,NSET={named[side]}", *_set_rows(np.unique(edges) + 1)]
    for side, edges in sides.items():
        lines.append(f"*SURFACE, NAME={named[side]}{EDGES}, TYPE=ELEMENT")
        lines += integer_rows("%d, S%d", faces_of(cells, edges) + 1)
    if subdomain.max(initial=0) > 0:
        for one in np.unique(subdomain).tolist():
            lines += [f"*ELSET,ELSET=subdomain_{one + 1}", *_set_rows(np.flatnonzero(subdomain == one) + 1)]
    return "\n".join(lines) + "\n"


def number(value: float) -> str:
    """The number in at most ``MAX_WIDTH`` characters: with all digits where they fit, else as many as fit."""
    text = repr(value)
    digits = 17
    while len(text) > MAX_WIDTH:
        digits -= 1
        text = f"{value:.{digits}g}"
    return text


def _set_rows(numbers: IntArray) -> Iterator[str]:
    """The rows of a set of nodes or cells."""
    texts = [*map(str, numbers.tolist())]
    return (", ".join(texts[k : k + PER_ROW]) for k in range(0, len(texts), PER_ROW))


def faces_of(cells: IntArray, edges: IntArray) -> IntArray:
    """The cell and the local face of each of the ``edges``, shape ``(k, 2)``; face j goes from corner j to the next."""
    corners = cells[:, : CORNERS[cells.shape[1]]]
    around = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    keys, wanted = (_keys(pairs, int(cells.max()) + 1) for pairs in (around, edges[:, :2]))
    order = np.argsort(keys)
    places = order[np.searchsorted(keys, wanted, sorter=order)]
    return np.column_stack(np.divmod(places, corners.shape[1]))


def _keys(pairs: IntArray, count: int) -> IntArray:
    """One number for both directions of an edge between two of ``count`` nodes."""
    keys: IntArray = pairs.min(axis=1).astype(np.int64) * count + pairs.max(axis=1)
    return keys
