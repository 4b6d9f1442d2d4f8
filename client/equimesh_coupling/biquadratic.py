"""The solution with elements of degree 2 on the cells of a mesh, for the error of a functional of that of degree 1.

With the adjoint z of degree 2 the residual ``f(z) - a(u_h, z)`` of a solution u_h is the functional of the solution of
degree 2 minus that of u_h. So this solution is all that is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.arrays import finite, real
from equimesh_coupling.elements import element_numbers, gauss, lagrange_functions
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.functionals import Places, answer, edges_next_to, edges_of_side
from equimesh_coupling.parts import Array, BoolArray, IntArray, MeshParts
from equimesh_coupling.recovery import edge_numbers, unique_edges

SourceFunction: TypeAlias = Callable[[Array, Array], npt.ArrayLike]
"""The right side of an equation, from arrays of x and y of one shape."""
PlacesFunction: TypeAlias = Callable[[MeshParts], Places]
"""From the parts of a mesh to the places whose values make a functional."""
FORM_POINTS, SOURCE_POINTS = 4, 12
"""Gauss points a direction and cell for the equation, and for its right side, which may have a narrow peak."""
MAX_HALVED = 20_000
"""The most cells of a mesh that is halved for the solution of degree 2, which has 16 unknowns a cell then.

On the last meshes of ``benchmarks/goals.py`` what corrected values lack falls by 2 to 40, on a round one by 1.3. On
cells that are not halved it was as large as an error whose parts cancel: the effectivity was 0.36, and is 0.81.
"""
NEAR_CORNER = 0.27
"""The place of the middle node of an edge at a corner with infinite slopes, as a share of the edge.

At a quarter quadratic functions of the edge have the root of the distance in them (R. S. Barsoum, International
Journal for Numerical Methods in Engineering 10, 1976); the map of the cell has to stay invertible, so it is a little
more. On step-14 of deal.II what the values lack falls by 1.7 to 7.
"""
LEAST_TURN = 1.15 * math.pi
"""The least angle inside of the domain at a corner with infinite slopes: twice it, where values are given on one side
alone. Nodes of round holes have smaller ones."""
LEAST_COSINE = 0.9
"""The least cosine of the turn of a side at a node across which given values are taken for smooth."""
MAX_BEND_SHARE = 0.25
"""How far the middle of an edge may move to a curved side, as a share of the thickness of its cell."""


@dataclass(frozen=True, kw_only=True)
class Equation:
    """``-div(diffusion grad u) + stream . grad u + reaction u = source``, with constant numbers."""

    diffusion: float
    stream: tuple[float, float]
    reaction: float
    source: SourceFunction | float

    def source_at(self, x: Array, y: Array) -> Array:
        """The right side at points. Raises :class:`BadValues` for numbers of another shape."""
        found = answer(self.source, x, y, "the source") if callable(self.source) else self.source
        values = finite(real(found, "the source"), "the source", "where every point needs a number")
        if values.shape not in ((), x.shape):
            raise BadValues(f"the source has answered with the shape {values.shape} for points of shape {x.shape}")
        return np.broadcast_to(values, x.shape)


def functional_of_degree_2(
    parts: MeshParts, equation: Equation, of: PlacesFunction | str, u: Array, is_fixed: BoolArray
) -> float:
    """The functional of the solution of degree 2, by ``of`` the places of a mesh, or of the flux through a side.

    The solution has the values of ``u`` at the nodes that are fixed. Nothing flows through the rest of the boundary.
    Cells are halved first, up to :data:`MAX_HALVED`. Raises :class:`BadValues` where the equations are singular.
    """
    solver = library("scipy.sparse.linalg", install="pip install scipy", package="scipy")
    if len(parts.cells) <= MAX_HALVED:
        parts, u, is_fixed = halved(parts, u, is_fixed)
    places = None if isinstance(of, str) else of(parts)
    near_point = parts.cells[places.cells] if places is not None and places.cells.size == 1 else None
    edges, nodes, points, values, known = nodes_of_degree_2(parts, u, is_fixed, near_point)
    matrix, load = assembled(points, nodes.reshape(-1, 9), equation)
    free = np.flatnonzero(~known)
    rows = matrix[free]
    try:
        factors = solver.splu(rows[:, free].tocsc(), permc_spec="MMD_AT_PLUS_A")  # half of the numbers of the default
        values[free] = factors.solve(load[free] - rows @ values)
    except RuntimeError as error:
        raise BadValues(f"the equations are singular ({error}): name the nodes with given values in fixed") from error
    if places is not None:
        functions = places.on(nodes.reshape(-1, 9), len(points), lambda s, t: lagrange_functions(2, s, t)[0])
        return float(functions @ values)
    left = matrix @ values - load
    weights = flux_weights_of_degree_2(parts, str(of), edges)
    return float(weights @ left[: weights.size])


class NodesOfDegree2(NamedTuple):
    """The nodes of elements of degree 2: those of a mesh, of its ``edges``, and of its cells."""

    edges: IntArray
    of_cells: IntArray
    """The nodes of each cell, shape ``(m, 3, 3)``."""
    points: Array
    values: Array
    """The given values, and zero at other nodes."""
    is_fixed: BoolArray


def nodes_of_degree_2(parts: MeshParts, u: Array, is_fixed: BoolArray, near_point: IntArray | None) -> NodesOfDegree2:
    """The nodes on the edges and in the cells of a mesh, next to corners nearer to these but for those ``near_point``.

    On sides they lie on parabolas, and so do the values of ``u`` there.
    """
    edges, numbers = unique_edges(parts.cells)
    outer = np.flatnonzero(np.bincount(numbers.ravel(), minlength=len(edges)) == 1)
    is_given = np.asarray(is_fixed[edges[outer]].all(axis=1))
    given, count, share = outer[is_given], len(parts.points), np.full((len(edges), 1), 0.5)
    corners = steep_corners(parts, edges[outer], is_given)
    if near_point is not None:
        corners = np.setdiff1d(corners, near_point)
    for end, near in enumerate((NEAR_CORNER, 1.0 - NEAR_CORNER)):
        share[np.isin(edges[:, end], corners)] = near
    middles = (1.0 - share) * parts.points[edges[:, 0]] + share * parts.points[edges[:, 1]]
    curved = on_sides(parts.points, edges[outer], share[outer], parts.points)
    is_thick = np.hypot(*(curved - middles[outer]).T) < MAX_BEND_SHARE * _thickness(parts, edges, numbers)[outer]
    middles[outer[is_thick]] = curved[is_thick]
    centres = 0.5 * middles[numbers].sum(axis=1) - 0.25 * parts.points[parts.cells].sum(axis=1)
    points = np.concatenate([parts.points, middles, centres])
    values, known = np.zeros(len(points)), np.zeros(len(points), dtype=bool)
    known[:count], known[count + given] = is_fixed, True
    values[:count][is_fixed] = u[is_fixed]
    values[count + given] = on_sides(parts.points, edges[given], share[given], u[:, None])[:, 0]
    return NodesOfDegree2(edges, element_numbers(parts.cells, count, 2), points, values, known)


def halved(parts: MeshParts, u: Array, is_fixed: BoolArray) -> tuple[MeshParts, Array, BoolArray]:
    """The mesh with four cells for each one, its given values, and the nodes that have these."""
    edges, nodes, points, values, known = nodes_of_degree_2(parts, u, is_fixed, None)
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    cells = [np.stack([nodes[:, i + k, j + m] for k, m in corners], axis=1) for i, j in corners]
    sides = {}
    for name, ends in parts.sides.items():
        middles = len(parts.points) + edge_numbers(ends, edges)
        sides[name] = np.stack([ends[:, 0], middles, middles, ends[:, 1]], axis=1).reshape(-1, 2)
    return MeshParts(points=points, cells=np.concatenate(cells), sides=sides, shape=None), values, known


def flux_weights_of_degree_2(parts: MeshParts, side: str, edges: IntArray) -> Array:
    """The weights of nodes and of middles of ``edges`` as :func:`~equimesh_coupling.functionals.flux_weights`.

    The flux through the side next to a corner is linear between the middles of the next two edges there.
    """
    count = len(parts.points)
    weights = np.zeros(count + len(edges))
    on_side = edges_of_side(parts, side)
    weights[on_side], weights[count + edge_numbers(on_side, edges)] = 1.0, 1.0
    others, pairs = edges_next_to(parts, side)
    for pair in pairs:
        ends = others[list(pair)]
        length, further = np.hypot(*(parts.points[ends[:, 1]] - parts.points[ends[:, 0]]).T)
        near, after = count + edge_numbers(ends, edges)
        slope = 0.25 * length / (length + further)
        weights[near] -= 0.25 + slope
        weights[after] += slope * length / further
    return weights


def _thickness(parts: MeshParts, edges: IntArray, numbers: IntArray) -> Array:
    """The area of a cell at each edge, over the length of the edge."""
    one, other = (parts.points[parts.cells[:, k + 2]] - parts.points[parts.cells[:, k]] for k in (0, 1))
    areas = np.empty(len(edges))
    areas[numbers] = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])[:, None]
    found: Array = areas / np.hypot(*(parts.points[edges[:, 1]] - parts.points[edges[:, 0]]).T)
    return found


def steep_corners(parts: MeshParts, edges: IntArray, given: BoolArray) -> IntArray:
    """Nodes of the boundary at which slopes have no limit: its ``edges``, and those on which values are ``given``."""
    corners = parts.points[parts.cells]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    angles = np.arctan2(cross, (ahead * behind).sum(axis=-1))
    count = len(parts.points)
    around = np.bincount(parts.cells.ravel(), angles.ravel(), minlength=count)
    sides = np.bincount(edges.ravel(), minlength=count)
    fixed = np.bincount(edges[given].ravel(), minlength=count)
    return np.flatnonzero((sides == 2) & (around * np.where(fixed == 1, 2.0, 1.0) > LEAST_TURN))


def on_sides(points: Array, edges: IntArray, share: Array, q: Array) -> Array:
    """``q`` of the nodes, shape ``(n, k)``, at a ``share`` of each of the ``edges`` of sides.

    It lies on parabolas through three nodes, where the side goes straight on: their second derivative is the mean of
    those at both nodes of an edge, and on the last edge goes on as it changes before.
    """
    begin, end = q[edges[:, 0]], q[edges[:, 1]]
    steps = points[edges[:, 1]] - points[edges[:, 0]]
    lengths = np.hypot(*steps.T)
    order = np.argsort(edges, axis=None, kind="stable")
    nodes = edges.ravel()[order]
    first = np.flatnonzero(np.bincount(nodes)[nodes] == 2)[::2]
    both, is_end = np.divmod(np.stack([order[first], order[first + 1]]), 2)  # the two edges at a node
    sign = 1.0 - 2.0 * is_end
    turn = -(sign.prod(axis=0) * (steps[both[0]] * steps[both[1]]).sum(axis=1)) / lengths[both].prod(axis=0)
    rise = ((sign / lengths[both])[..., None] * (end - begin)[both]).sum(axis=0) / lengths[both].sum(axis=0)[:, None]
    both, rise = both[:, turn > LEAST_COSINE], rise[turn > LEAST_COSINE]
    bends, counts = np.zeros_like(begin), np.bincount(both.ravel(), minlength=len(edges))
    np.add.at(bends, both.ravel(), np.tile(rise, (2, 1)))
    bends /= np.maximum(counts, 1)[:, None]
    last, before = np.concatenate([both, both[::-1]], axis=1)
    last, before = (one[(counts[last] == 1) & (counts[before] == 2)] for one in (last, before))
    further = np.minimum(1.0, lengths[last] / lengths[before])[:, None]
    bends[last] += further * (bends[last] - bends[before])
    return np.asarray((1.0 - share) * begin + share * end - share * (1.0 - share) * lengths[:, None] ** 2 * bends)


def assembled(points: Array, nodes: IntArray, equation: Equation) -> tuple[Any, Array]:
    """The matrix and the load of all nodes of degree 2, whose ``points`` place the cells, too."""
    sparse = library("scipy.sparse", install="pip install scipy", package="scipy")
    of_cells, form = points[nodes], np.zeros((len(nodes), 9, 9))
    for functions, along, across, weight in _rule(FORM_POINTS):
        det, x, y = _slopes(of_cells, along, across)
        form += (weight * equation.diffusion * det)[:, None, None] * (
            x[:, :, None] * x[:, None, :] + y[:, :, None] * y[:, None, :]
        )
        if equation.reaction or any(equation.stream):
            carried = equation.stream[0] * x + equation.stream[1] * y + equation.reaction * functions
            form += (weight * det)[:, None, None] * (functions[:, None] * carried[:, None, :])
    load = np.zeros((len(nodes), 9))
    for functions, along, across, weight in _rule(SOURCE_POINTS if callable(equation.source) else FORM_POINTS):
        det, _, _ = _slopes(of_cells, along, across)
        x, y = (functions @ of_cells[..., k].T for k in (0, 1))
        load += (weight * det * equation.source_at(x, y))[:, None] * functions
    rows, columns = np.repeat(nodes, 9, axis=1).ravel(), np.tile(nodes, (1, 9)).ravel()
    matrix = sparse.csr_matrix((form.ravel(), (rows, columns)), shape=(len(points), len(points)))
    right: Any = np.bincount(nodes.ravel(), load.ravel(), minlength=len(points))
    return matrix, right


def _rule(count: int) -> Iterator[tuple[Array, Array, Array, float]]:
    """Shape functions, their derivatives along s and t, and the weight, at the points of a Gauss rule."""
    at, share = gauss(count)
    s, t = (q.ravel() for q in np.meshgrid(at, at, indexing="ij"))
    functions, along, across = lagrange_functions(2, s, t)
    for k, weight in enumerate(np.outer(share, share).ravel().tolist()):
        yield functions[:, k], along[:, k], across[:, k], weight


def _slopes(of_cells: Array, along: Array, across: Array) -> tuple[Array, Array, Array]:
    """The determinant of the map of each cell, and the derivatives of shape functions by x and y, ``(m, 9)``."""
    x_s, y_s = (of_cells[..., k] @ along for k in (0, 1))
    x_t, y_t = (of_cells[..., k] @ across for k in (0, 1))
    det = x_s * y_t - x_t * y_s
    x = (y_t[:, None] * along - y_s[:, None] * across) / det[:, None]
    y = (x_s[:, None] * across - x_t[:, None] * along) / det[:, None]
    return det, x, y
