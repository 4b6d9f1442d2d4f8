"""The named sides of a domain of blocks: edges of its boundary, in their order along the side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from equimesh.blocks.counts import Plan
from equimesh.blocks.description import Description
from equimesh.blocks.layout import RISES_WITH_BLOCK_ON_LEFT, Layout
from equimesh.errors import InputError
from equimesh.numerics.types import IntArray

# The name of the edges of the boundary that no side names, and another one where that is taken.
REST = ("boundary", "unnamed")


def sides_of(description: Description, plan: Plan) -> dict[str, tuple[int, ...]]:
    """The edges of every side, by its name, in the order of the description.

    Edges of the boundary without a name are the side ``boundary``. Joined edges without a name are ``periodic0`` and
    ``periodic0_copy`` and so on. Raises :class:`~equimesh.errors.InputError` where a side has an edge inside the
    domain, or one of another side.
    """
    found: dict[str, tuple[int, ...]] = {}
    owner: dict[int, str] = {}
    for name, pairs in description.sides.items():
        edges = []
        for k, ends in enumerate(pairs):
            field = f"domain.sides.{name}[{k}]"
            edge = plan.find(ends, field)
            if plan.layout.edge_uses[edge] != 1:
                message = f"{ends[0]}-{ends[1]} is no edge of the boundary: blocks lie on both sides of it"
                raise InputError(message, field=field)
            if edge in owner:
                raise InputError(f"{ends[0]}-{ends[1]} belongs to the side {owner[edge]} already", field=field)
            owner[edge] = name
            edges.append(edge)
        if edges:
            found[name] = tuple(edges)
    for k, (one, copy, _) in enumerate(plan.layout.joins.tolist()):
        for name, edge in ((f"periodic{k}", one), (f"periodic{k}_copy", copy)):
            if edge not in owner:
                found[_free(found, (name,))] = (edge,)
    rest = tuple(int(edge) for edge in plan.layout.boundary if int(edge) not in owner)
    if rest:
        found[_free(found, REST)] = rest
    return found


def fixed_edges(description: Description, plan: Plan) -> tuple[int, ...]:
    """The edges between blocks on whose lines the nodes stay.

    Raises :class:`~equimesh.errors.InputError` for an edge of the boundary, a joined one, and one that is named twice.
    """
    found: list[int] = []
    for k, ends in enumerate(description.fixed):
        field = f"domain.fixed[{k}]"
        edge = plan.find(ends, field)
        if plan.layout.edge_uses[edge] == 1:
            message = f"{ends[0]}-{ends[1]} is no edge between two blocks: nodes of the boundary stay on it anyway"
            raise InputError(message, field=field)
        if edge in found:
            raise InputError(f"{ends[0]}-{ends[1]} is named twice", field=field)
        found.append(edge)
    return tuple(found)


def side_edges(
    layout: Layout, edge_nodes: Sequence[IntArray], sides: Mapping[str, Iterable[int]]
) -> dict[str, IntArray]:
    """The boundary edges of the mesh on every side, shape ``(k, 2)``, the domain on their left.

    They are in their order along the side: edges that meet follow each other, whatever their order in ``sides``.
    """
    left_of = np.empty(len(layout.edges), dtype=bool)
    left_of[layout.block_edges] = layout.forward == np.array(RISES_WITH_BLOCK_ON_LEFT)
    found = {}
    for name, edges in sides.items():
        lines = [edge_nodes[edge][:: 1 if left_of[edge] else -1] for edge in edges]
        ordered = [lines[k] for k in _in_order([(int(line[0]), int(line[-1])) for line in lines])]
        found[name] = np.concatenate([np.column_stack([line[:-1], line[1:]]) for line in ordered])
    return found


def _in_order(ends: Sequence[tuple[int, int]]) -> list[int]:
    """The places of directed pieces such that each follows the one that ends where it begins."""
    begins: dict[int, list[int]] = {}
    for k, (first, _) in enumerate(ends):
        begins.setdefault(first, []).append(k)
    lasts = {last for _, last in ends}
    starts = [k for k, (first, _) in enumerate(ends) if first not in lasts]
    found: list[int] = []
    done = [False] * len(ends)
    for start in [*starts, *range(len(ends))]:
        following = [start]
        while following and not done[following[0]]:
            piece = following[0]
            done[piece] = True
            found.append(piece)
            following = [other for other in begins.get(ends[piece][1], ()) if not done[other]]
    return found


def _free(taken: Mapping[str, object], names: Sequence[str]) -> str:
    """The first of ``names`` that is not taken, else the last one with a number."""
    for name in names:
        if name not in taken:
            return name
    return next(name for k in range(2, len(taken) + 3) if (name := f"{names[-1]}{k}") not in taken)
