"""What it takes to write a mesh in parts: CPU time and bytes of every format for each point.

    python benchmarks/parted_files.py --points 2049 --parts 4 --folder /tmp

The mesh has u at its nodes, and in its cells the number of the part. Times are those of this process, its threads
included; the parts are written one after the other. ``read`` is the time of reading x, y and u row by row.
docs/reference/formats.md quotes the table.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import equimesh as em
from equimesh.numerics.types import Array
from equimesh_cluster import PARTED_FORMATS, MeshPart, PartData, cut, read_parts, write_head, write_part


@dataclass(frozen=True, kw_only=True)
class Cost:
    """CPU nanoseconds of writing parts, head, and of reading, and bytes, all for each point of the mesh."""

    format: str
    write: float
    head: float
    read: float
    bytes: float


def bent_mesh(points: int) -> em.Mesh:
    """A mesh whose coordinates are no short decimals, which would pack well."""
    xi = np.linspace(0.0, 1.0, points)
    bump = 0.1 * np.sin(np.pi * xi)[:, None] * np.sin(np.pi * xi)
    return em.Mesh(np.sqrt(xi)[:, None] + bump * (1.0 - xi[:, None]), (xi**1.5)[None, :] - bump * xi)


def cost(name: str, parts: Sequence[MeshPart], values: Sequence[Array], folder: Path) -> Cost:
    """The cost of one format. ``values`` are u at the nodes of every part."""
    head, grid = folder / f"mesh{PARTED_FORMATS[name].suffix}", parts[0].grid
    begin = time.process_time()
    for part, u in zip(parts, values, strict=True):
        write_part(head, part, PartData(nodes={"u": u}))
    written = time.process_time()
    write_head(head, grid=grid, cuts=[part.first for part in parts[1:]], nodes=("u",))
    finished = time.process_time()
    for array in ("x", "y", "u"):
        for _ in read_parts(head).blocks(array):
            pass
    end = time.process_time()
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    write, tie, read = (
        1e9 * seconds / grid.points for seconds in (written - begin, finished - written, end - finished)
    )
    return Cost(format=name, write=write, head=tie, read=read, bytes=size / grid.points)


def costs(points: int, count: int, folder: Path | None = None) -> list[Cost]:
    """The costs of all formats on a mesh of ``points`` by ``points`` in ``count`` parts."""
    mesh = bent_mesh(points)
    parts = cut(mesh, [points * number // count for number in range(1, count)])
    values = [np.tanh(20.0 * (part.x - part.y)) for part in parts]
    found = []
    for name in PARTED_FORMATS:
        small = cut(bent_mesh(9), ())
        with TemporaryDirectory(dir=folder) as place:  # imports what the format needs
            cost(name, small, [small[0].x], Path(place))
        with TemporaryDirectory(dir=folder) as place:
            found.append(cost(name, parts, values, Path(place)))
    return found


def lines(found: Sequence[Cost]) -> list[str]:
    """The rows of a table."""
    rows = [f"| `{c.format}` | {c.write:.0f} | {c.head:.1f} | {c.read:.0f} | {c.bytes:.1f} |" for c in found]
    return ["| format | write, CPU ns | head, CPU ns | read, CPU ns | bytes |", "|---|---|---|---|---|", *rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=2049, help="points of the mesh in each direction")
    parser.add_argument("--parts", type=int, default=4)
    parser.add_argument("--folder", type=Path, default=None, help="where files are written and removed again")
    options = parser.parse_args()
    print("\n".join(lines(costs(options.points, options.parts, options.folder))))


if __name__ == "__main__":
    main()
