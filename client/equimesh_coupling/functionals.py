"""Functionals of a solution by its values at places in cells, and their weights for nodes of elements."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.elements import gauss
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, BoolArray, IntArray, MeshParts
from equimesh_coupling.recovery import edge_numbers, unique_edges

Region: TypeAlias = Callable[[Array, Array], npt.ArrayLike]
"""Whether points belong to a region, from arrays of x and y of one shape."""
FEW_POINTS = 3
"""Gauss points a direction for integrals over a cell, and along an edge."""
SEEN_POINTS = 12
"""Points a direction, those of the edges included, that tell whether a cell lies in a region, in part or not."""
LINES, INTERVALS = 512, 8
"""Lines across a cell that lies in a region in part, and intervals of each of them."""
HALVINGS = 40
"""Halvings of the interval in which a line enters or leaves a region."""
MAX_SEARCH_STEPS = 30
"""Steps of Newton's method for the place of a point in a cell."""
EDGE = 1e-9
"""How far outside of a cell, in its own coordinates, a point on its edge may seem to be by rounding."""


@dataclass(frozen=True, eq=False)
class Places:
    """The sum of ``weights`` times the values at places ``s``, ``t``, 0 to 1, in cells of the numbers ``cells``."""

    cells: IntArray
    s: Array
    t: Array
    weights: Array

    def on(self, nodes: IntArray, count: int, functions: Callable[[Any, Any], Array]) -> Array:
        """The weights of ``count`` nodes, of which each cell has those in its row of ``nodes``."""
        shares = functions(self.s, self.t) * self.weights
        found: Any = np.bincount(nodes[self.cells].T.ravel(), shares.ravel(), minlength=count)
        return np.asarray(found, dtype=float)


def place_of_point(parts: MeshParts, x: float, y: float) -> Places:
    """The place of a point; raises :class:`BadValues` for one outside of the mesh."""
    corners = parts.points[parts.cells]
    inside = ((corners.min(axis=1) <= (x, y)) & (corners.max(axis=1) >= (x, y))).all(axis=1)
    for cell in np.flatnonzero(inside):
        s, t = _place(corners[cell], np.array([x, y]))
        if max(abs(s - 0.5), abs(t - 0.5)) <= 0.5 + EDGE:
            return Places(np.array([cell]), np.array([s]), np.array([t]), np.ones(1))
    raise BadValues(f"the point ({x:g}, {y:g}) lies outside of the mesh: give one inside")


def _place(corners: Array, point: Array) -> tuple[float, float]:
    """The coordinates of a point in a cell, by Newton's method; infinite where it finds none."""
    s = t = 0.5
    for _ in range(MAX_SEARCH_STEPS):
        lower, upper = corners[0] + s * (corners[1] - corners[0]), corners[3] + s * (corners[2] - corners[3])
        along = (1.0 - t) * (corners[1] - corners[0]) + t * (corners[2] - corners[3])
        across, rest = upper - lower, point - (lower + t * (upper - lower))
        det = along[0] * across[1] - along[1] * across[0]
        if det == 0.0:
            break
        s += (rest[0] * across[1] - rest[1] * across[0]) / det
        t += (rest[1] * along[0] - rest[0] * along[1]) / det
    return (s, t) if math.isfinite(s + t) else (math.inf, math.inf)


def shape_functions(s: Any, t: Any) -> Array:
    """The four bilinear shape functions, in the order of the corners of a cell."""
    return np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])


def places_in_region(parts: MeshParts, region: Region | None) -> Places:
    """The integral over the cells, or over what of them lies in a region.

    In a cell on the border of the region lines end where they leave it. Raises :class:`BadValues` where no cell has a
    part in the region.
    """
    at, share = gauss(FEW_POINTS)
    s, t = (q.ravel() for q in np.meshgrid(at, at, indexing="ij"))
    weights, every = np.outer(share, share).ravel(), np.arange(len(parts.cells))
    if region is None:
        return _in_cells(parts, every, s, t, weights)
    seen = np.linspace(0.0, 1.0, SEEN_POINTS)
    shape = shape_functions(*(q.ravel() for q in np.meshgrid(seen, seen))).T
    x, y = parts.points[parts.cells].T
    inside = _is_in(region, shape @ x, shape @ y)
    whole, some = inside.all(axis=0), inside.any(axis=0)
    found = [_in_cells(parts, every[whole], s, t, weights), _in_parts(parts, every[some & ~whole], region)]
    places = Places(*(np.concatenate([getattr(one, name) for one in found]) for name in ("cells", "s", "t", "weights")))
    if not places.weights.any():
        raise BadValues("no cell of the mesh has a part in the region: the functional is constant")
    return places


def _in_cells(parts: MeshParts, cells: IntArray, s: Array, t: Array, weights: Array) -> Places:
    """The same places in all of the ``cells``, with ``weights`` for a cell of area 1."""
    repeated, (s, t) = np.repeat(cells, s.size), (np.tile(q, len(cells)) for q in (s, t))
    return Places(repeated, s, t, np.tile(weights, len(cells)) * _areas(parts, repeated, s, t))


def _in_parts(parts: MeshParts, cells: IntArray, region: Region) -> Places:
    """Two Gauss points on what of each interval of lines across ``cells`` lies in the region."""
    ends, middles = np.linspace(0.0, 1.0, INTERVALS + 1), (np.arange(LINES) + 0.5) / LINES
    every, along = (q.ravel() for q in np.meshgrid(np.arange(len(cells)), middles, indexing="ij"))

    def is_in(which: IntArray, s: Array) -> BoolArray:
        points = parts.points[parts.cells[cells[every[which]]]].transpose(1, 0, 2)
        x, y = (shape_functions(s, along[which])[..., None] * points).sum(axis=0).T
        return _is_in(region, x, y)

    lines = np.repeat(np.arange(every.size), ends.size)
    inside = is_in(lines, np.tile(ends, every.size)).reshape(every.size, ends.size)
    line, interval = np.nonzero(inside[:, 1:] | inside[:, :-1])
    begin, end = ends[interval].copy(), ends[interval + 1].copy()
    enters = inside[line, interval + 1] & ~inside[line, interval]
    leaves = inside[line, interval] & ~inside[line, interval + 1]
    cut = np.flatnonzero(enters | leaves)
    low, high = begin[cut].copy(), end[cut].copy()
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        as_low = is_in(line[cut], middle) == leaves[cut]
        low, high = np.where(as_low, middle, low), np.where(as_low, high, middle)
    begin[cut], end[cut] = np.where(enters[cut], low, begin[cut]), np.where(leaves[cut], low, end[cut])
    s: Array = (begin + gauss(2)[0][:, None] * (end - begin)).ravel()
    t: Array = np.tile(along[line], 2)
    cell = np.tile(cells[every[line]], 2)
    return Places(cell, s, t, np.tile(0.5 * (end - begin) / LINES, 2) * _areas(parts, cell, s, t))


def _is_in(region: Region, x: Array, y: Array) -> BoolArray:
    found = answer(region, x, y, "the region")
    if found.shape != x.shape or found.dtype.kind not in "biu":
        raise BadValues(
            f"the region has answered with the shape {found.shape} of {found.dtype} for points of shape {x.shape}:"
            " return whether each point is in it, such as x > 0.5"
        )
    return found.astype(bool)


def answer(function: Callable[[Array, Array], npt.ArrayLike], x: Array, y: Array, what: str) -> npt.NDArray[Any]:
    """What a ``function`` of points returns; raises :class:`BadValues`, about ``what``, where it takes no arrays."""
    try:
        return np.asarray(function(x, y))
    except (TypeError, ValueError) as error:
        raise BadValues(
            f"{what} takes no arrays of x and y ({error!s:.80}): use functions of numpy, and & in place of and"
        ) from error


def _areas(parts: MeshParts, cells: IntArray, s: Array, t: Array) -> Array:
    """The determinants of the bilinear maps of ``cells``."""
    corners = parts.points[parts.cells]
    a, b, c = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]
    twist = (c - b)[cells]
    along, across = a[cells] + t[:, None] * twist, b[cells] + s[:, None] * twist
    found: Array = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    return found


def places_on_side(parts: MeshParts, side: str) -> Places:
    """The integral along a side."""
    wanted, (edges, numbers) = edges_of_side(parts, side), unique_edges(parts.cells)
    cell_of = np.empty(len(edges), dtype=np.int64)
    cell_of[numbers.ravel()] = np.arange(numbers.size)
    cell, first = np.divmod(cell_of[edge_numbers(wanted, edges)], 4)
    at, share = gauss(FEW_POINTS)
    lengths = np.hypot(*(parts.points[wanted[:, 1]] - parts.points[wanted[:, 0]]).T)
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    begin, end = corner[first], corner[(first + 1) % 4]
    s, t = (begin[:, None] + at[:, None] * (end - begin)[:, None]).reshape(-1, 2).T
    return Places(np.repeat(cell, at.size), s, t, np.outer(lengths, share).ravel())


def edges_of_side(parts: MeshParts, side: str) -> IntArray:
    """The edges of a side, shape ``(k, 2)``; raises :class:`BadValues` for a name that the mesh has not."""
    if not isinstance(side, str) or side not in parts.sides:
        names = ", ".join(map(repr, parts.sides))
        raise BadValues(f"the mesh has no side {side!r:.40}: its sides are {names}")
    return parts.sides[side]


def nodes_of_side(parts: MeshParts, side: str) -> Array:
    """1 at the nodes of a side, 0 elsewhere."""
    weights = np.zeros(len(parts.points))
    weights[edges_of_side(parts, side).ravel()] = 1.0
    return weights


def flux_weights(parts: MeshParts, side: str) -> Array:
    """The weights of what is left of the equations of the nodes for the flux through a side.

    They are 1 at its nodes. The node of a corner has a part of the flux through the side next to it, too, which is
    linear between the next two nodes there: their weights take it off.
    """
    weights = nodes_of_side(parts, side)
    others, pairs = edges_next_to(parts, side)
    lengths = np.hypot(*(parts.points[others[:, 1]] - parts.points[others[:, 0]]).T)
    around = 0.5 * np.bincount(others.ravel(), np.repeat(lengths, 2), minlength=weights.size)
    for edge, after in pairs:
        near = np.intersect1d(others[edge], others[after])
        far, length = np.setdiff1d(others[after], near), lengths[edge]
        slope = min(1.0, length / lengths[after])
        weights[near] -= length / 6.0 * (3.0 + 2.0 * slope) / around[near]
        weights[far] += length / 3.0 * slope / around[far]
    return weights


def edges_next_to(parts: MeshParts, side: str) -> tuple[IntArray, list[tuple[int, int]]]:
    """The edges of all other sides, and the numbers of the first two of them from each end of the ``side`` on.

    An end is left out where the next side has fewer than three edges.
    """
    others = np.concatenate([parts.sides[side][:0], *(edges for name, edges in parts.sides.items() if name != side)])
    on_side, found = np.isin(others, edges_of_side(parts, side)), []
    for edge in np.flatnonzero(on_side.sum(axis=1) == 1).tolist():
        touches = (others == others[edge][~on_side[edge]]).any(axis=1)
        touches[edge] = False
        if touches.sum() == 1 and not on_side[touches].any():
            found.append((edge, int(touches.argmax())))
    return others, found
