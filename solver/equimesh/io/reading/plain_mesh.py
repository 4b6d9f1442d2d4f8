"""A mesh as a file holds it: points, cells and named sides, checked and without what no cell uses."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import check_name
from equimesh.numerics.types import Array, IntArray

# A mesh is plane where its nodes leave the plane by this part of its size at most.
PLANE: float = 1e-9
# Named sides of a mesh, at most: each has an array.
MAX_SIDES: int = 1000
# Edges of all sides for each cell, at most: a cell has four edges, and an edge may be of several sides.
MAX_EDGES: int = 40
# Named points and blocks of a mesh, at most.
MAX_PLACES: int = 10_000
MAX_BLOCKS: int = 100_000
# What to do with a mesh that has other cells, for messages.
ONLY_QUADRILATERALS: str = (
    "only quadrilaterals can be adapted; make a mesh of quadrilaterals, in Gmsh by Recombine with the subdivision"
    " algorithm 'All Quads'"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainMesh:
    """A mesh of quadrilaterals as a file holds it.

    - ``points``: coordinates, shape ``(n, 2)``, in the order of the file.
    - ``cells``: nodes of each cell, shape ``(m, 4)``, in the order and direction of the file.
    - ``sides``: the edges of each named side, shape ``(k, 2)``, in the order and direction of the file.
    - ``places``: the nodes of points that have a name.
    - ``blocks``: the name of each block of the file, and the number of its cells, which are block by block; empty where
      the file has no blocks.
    """

    points: Array
    cells: IntArray
    sides: Mapping[str, IntArray] = field(default_factory=dict)
    places: Mapping[str, int] = field(default_factory=dict)
    blocks: tuple[tuple[str, int], ...] = ()

    def __post_init__(self) -> None:
        check_names(self.sides, self.places, [name for name, _ in self.blocks])

    @classmethod
    def of(
        cls,
        points: Array,
        cells: IntArray,
        sides: Mapping[str, IntArray],
        places: Mapping[str, int] | None = None,
    ) -> PlainMesh:
        """The mesh without the points that no cell uses; ``points`` have two columns, or a third that is constant.

        Raises :class:`~equimesh.errors.InputError` for a mesh without cells, for coordinates that are not finite or
        leave the plane, and for numbers that are no nodes.
        """
        if len(cells) == 0:
            raise InputError(f"the file has no quadrilaterals: {ONLY_QUADRILATERALS}", field="cells")
        check_names(sides, places or {}, ())
        for name, table in {
            "the cells": cells,
            **{f"the side {name!r}": edges for name, edges in sides.items()},
        }.items():
            if table.size and not (table.min() >= 0 and table.max() < len(points)):
                row = int(((table < 0) | (table >= len(points))).any(axis=1).argmax())
                message = (
                    f"{name}: number {row} has the nodes {table[row].tolist()}, but the file has {len(points)} nodes"
                )
                raise InputError(message, field="cells")
        used = np.zeros(len(points), np.bool_)
        used[cells] = True
        if len(cells) > used.sum():
            message = f"the file has {len(cells)} cells of {used.sum()} nodes: some lie on each other, remove them"
            raise InputError(message, field="cells")
        edge_count = sum(map(len, sides.values()))
        if edge_count > MAX_EDGES * len(cells):
            message = f"the sides have {edge_count} edges, the mesh {len(cells)} cells: name each edge once"
            raise InputError(message, field="sides")
        for name, edges in sides.items():
            if not used[edges].all():
                row = int((~used[edges]).any(axis=1).argmax())
                message = f"the side {name!r} has the edge {edges[row].tolist()} of nodes that no cell has: remove it"
                raise InputError(message, field="sides")
        kept = np.flatnonzero(used)
        finite = np.isfinite(points[kept]).all(axis=1)
        if not finite.all():
            node = int(kept[finite.argmin()])
            raise InputError(
                f"node {node} has the coordinates {points[node].tolist()}: they must be finite", field="points"
            )
        plane = _in_plane(points, kept)
        if len(kept) == len(points):
            return cls(points=plane, cells=cells, sides=dict(sides), places=dict(places or {}))
        number = np.cumsum(used) - 1
        return cls(
            points=plane,
            cells=number[cells],
            sides={name: number[edges] for name, edges in sides.items()},
            places={name: int(number[node]) for name, node in (places or {}).items() if used[node]},
        )


def check_names(sides: Collection[str], places: Collection[str], blocks: Collection[str]) -> None:
    """Refuse more named things than a mesh may have, and names that are too long."""
    check_side_count(len(sides))
    for what, where, names, most in (
        ("side", "sides", sides, MAX_SIDES),
        ("point", "points", places, MAX_PLACES),
        ("block", "blocks", blocks, MAX_BLOCKS),
    ):
        if len(names) > most:
            raise InputError(f"the file has {len(names)} named {what}s: {most} are possible", field=where)
        for name in names:
            check_name(name, f"a {what}", where)


def check_side_count(count: int, field: str = "sides") -> None:
    """Refuse more sides than a mesh may have."""
    if count > MAX_SIDES:
        raise InputError(f"there are {count} named sides: {MAX_SIDES} are possible", field=field)


def _in_plane(points: Array, kept: IntArray) -> Array:
    """The first two coordinates of the nodes ``kept``, whose third must be constant."""
    if points.shape[1] > 2:
        z = points[kept, 2]
        off = np.abs(z - z[0])
        size = float(np.ptp(points[kept, :2], axis=0).max())
        if off.max() > PLANE * size:
            node = int(kept[off.argmax()])
            message = (
                f"the mesh leaves the plane: node {node} has z = {points[node, 2]:.6g}, node {kept[0]} has"
                f" z = {z[0]:.6g}; only plane meshes with a constant z can be adapted"
            )
            raise InputError(message, field="points")
    return np.ascontiguousarray(points[kept, :2])


def refuse_cell(kind: str, number: int, points: Array, nodes: IntArray) -> InputError:
    """The error for a cell that is no quadrilateral; ``nodes`` are its nodes among ``points``."""
    known = nodes[(nodes >= 0) & (nodes < len(points))]
    where = ""
    if len(known):
        x, y = points[known, :2].mean(axis=0)
        where = f" near ({x:.6g}, {y:.6g})"
    return InputError(f"cell {number} of the file{where} is a {kind}: {ONLY_QUADRILATERALS}", field="cells")
