"""The edges of a mesh on the curved sides of its domain, with the points of the sides in their middle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Line
from equimesh.blocks.sliding import FIXED
from equimesh.domains.domain import Domain, Rectangle, closed_of
from equimesh.fields.on_domain import inverse_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import FIRST_BEND, CurvedEdges
from equimesh.numerics.types import Array, IntArray

CurvePoints: TypeAlias = Callable[[Array], tuple[Array, Array]]
"""A curve: x and y at values of its parameter."""
Piece: TypeAlias = tuple[IntArray, CurvePoints, Array, Array]
"""Edges on a curve, shape ``(k, 2)``, the curve, and the parameters where they begin and end."""
STEPS = 60
"""Halvings of the interval in which a middle is sought: as many as numbers have digits."""


def curved_edges(mesh: Mesh, domain: Domain | Blocks) -> CurvedEdges:
    """The edges of ``mesh``, a mesh of ``domain``, on sides that are curved there."""
    if isinstance(domain, Blocks):
        pieces = _on_blocks(mesh.points, domain)
    else:
        pieces = iter(()) if isinstance(domain, Rectangle) else _on_sides(mesh, domain)
    found = [(edges, middles_of(curve, begin, end, mesh.points[edges])) for edges, curve, begin, end in pieces]
    edges = np.concatenate([np.empty((0, 2), dtype=np.int64), *(edges for edges, _ in found)])
    middles = np.concatenate([np.empty((0, 2)), *(middles for _, middles in found)])
    ends = mesh.points[edges]
    bends, lengths = (np.hypot(*v.T) for v in (middles - ends.mean(axis=1), ends[:, 1] - ends[:, 0]))
    is_curved = bends > FIRST_BEND * lengths
    return CurvedEdges(edges[is_curved], middles[is_curved])


def middles_of(curve: CurvePoints, begin: Array, end: Array, ends: Array) -> Array:
    """The points of a curve between two parameters that are as far from one of the ``ends`` as from the other.

    ``begin`` and ``end`` have the shape ``(k,)``, ``ends`` ``(k, 2, 2)``, the points ``(k, 2)``.
    """
    low, high = begin.copy(), end.copy()
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        places = np.stack(curve(middle), axis=-1)
        from_begin, from_end = (np.hypot(*(places - ends[:, k]).T) for k in (0, 1))
        is_before = from_begin < from_end
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    return places


def _on_sides(mesh: Mesh, domain: Domain) -> Iterator[Piece]:
    """The edges on the four sides of a domain, but for those of a seam."""
    inverse, closed = inverse_of(domain), closed_of(domain)
    for name, edges in mesh.sides.items():
        axis = 0 if name in ("left", "right") else 1
        if closed[axis]:
            continue
        ends = mesh.points[edges]
        begin, end = np.moveaxis(inverse.at(ends[..., 0], ends[..., 1])[1 - axis], -1, 0)
        if closed[1 - axis]:
            end = begin + (end - begin) - np.round(end - begin)
        across = 0.0 if name in ("left", "bottom") else 1.0
        yield edges, _side(domain, axis, across, turns=closed[1 - axis]), begin, end


def _side(domain: Domain, axis: int, across: float, *, turns: bool) -> CurvePoints:
    """A side of a domain by the share of the way along it; after a whole turn it begins anew where it is closed."""

    def points(along: Array) -> tuple[Array, Array]:
        along = np.mod(along, 1.0) if turns else along
        fixed = np.full(along.shape, across)
        return domain.map(fixed, along) if axis == 0 else domain.map(along, fixed)

    return points


def _on_blocks(points: Array, domain: Blocks) -> Iterator[Piece]:
    """The edges on the curves of a domain in blocks, but for lines."""
    for edge in domain.boundary_edges:
        curve, nodes = domain.curves[edge.curve], edge.nodes
        if isinstance(curve, Line):
            continue
        t = np.array(curve.nearest(points[nodes, 0], points[nodes, 1]), dtype=float)
        for at in (0, -1):  # an end of the curve may be another end of it, too
            if domain.node_curve[nodes[at]] == FIXED:
                t[at] = edge.parameters[at]
        begin, end = t[:-1], t[1:]
        if curve.closed:
            turn = curve.ends[1] - curve.ends[0]
            end = begin + (end - begin) - turn * np.round((end - begin) / turn)

        def places(along: Array, curve: object = curve) -> tuple[Array, Array]:
            return curve.evaluate(along)[:2]  # type: ignore[attr-defined, no-any-return]

        yield np.column_stack([nodes[:-1], nodes[1:]]), places, begin, end
