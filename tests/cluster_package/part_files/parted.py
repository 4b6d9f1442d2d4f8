"""A mesh that is written in parts, and what must be read back of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from equimesh_cluster import PARTED_FORMATS, PartData, write_head, write_part
from equimesh_cluster.mesh_part import MeshPart, cut
from solver.io.files import adapted

# More rows than a chunk of a zarr group has, and a number that no chunk divides.
N_XI, N_ETA = 97, 21
DATA = adapted(N_XI, N_ETA)
# Where the parts begin, for 1, 3 and 4 parts. Some parts are shorter than a chunk of a zarr group.
CUTS: tuple[tuple[int, ...], ...] = ((), (33, 41), (17, 33, 66))
assert DATA.u is not None
ARRAYS = {"x": DATA.mesh.x, "y": DATA.mesh.y, "u": DATA.u, "v": DATA.mesh.x + 2 * DATA.mesh.y, "Q_eq": DATA.q_eq}


def data_of(part: MeshPart) -> PartData:
    """u as an array, v as a function of x and y, and an array in cells."""
    first, last = part.cell_rows
    return PartData(
        nodes={"u": ARRAYS["u"][first : last + 1], "v": lambda x, y: x + 2 * y},
        cells={"Q_eq": ARRAYS["Q_eq"][first:last]},
    )


def parts_of(cuts: tuple[int, ...]) -> list[MeshPart]:
    return cut(DATA.mesh, cuts)


def written(folder: Path, name: str, cuts: tuple[int, ...]) -> Path:
    """The head of the mesh in the format ``name``."""
    head = folder / f"mesh{PARTED_FORMATS[name].suffix}"
    for part in reversed(parts_of(cuts)):  # in no order
        write_part(head, part, data_of(part))
    assert write_head(head, grid=DATA.mesh.grid, cuts=cuts, nodes=("u", "v"), cells=("Q_eq",)) == head
    return head


def subdomains(cuts: tuple[int, ...]) -> np.ndarray:
    """The number of the part of every cell."""
    rows = np.searchsorted(cuts, np.arange(N_XI - 1), side="right")
    return np.broadcast_to(rows[:, None], (N_XI - 1, N_ETA - 1))
