"""The solution with elements of degree 2 on the cells of a mesh, for the error of a functional of that of degree 1.

With the adjoint z of degree 2 the residual ``f(z) - a(u_h, z)`` of a solution u_h is the functional of the solution of
degree 2 minus that of u_h. So this solution is all that is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.arrays import finite, real
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.functionals import Places
from equimesh_coupling.parts import Array, IntArray, MeshParts
from equimesh_coupling.recovery import unique_edges

SourceFunction: TypeAlias = Callable[[Array, Array], npt.ArrayLike]
"""The right side of an equation, from arrays of x and y of one shape."""
FORM_POINTS, SOURCE_POINTS = 4, 12
"""Gauss points a direction and cell for the equation, and for its right side, which may have a narrow peak."""
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
NODES = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1))
"""The nodes of a cell in halves of it: corners, middles of edges, and the centre."""


@dataclass(frozen=True, kw_only=True)
class Equation:
    """``-div(diffusion grad u) + stream . grad u + reaction u = source``, with constant numbers."""

    diffusion: float
    stream: tuple[float, float]
    reaction: float
    source: SourceFunction | float

    def source_at(self, x: Array, y: Array) -> Array:
        """The right side at points. Raises :class:`BadValues` for numbers of another shape."""
        found = self.source(x, y) if callable(self.source) else self.source
        values = finite(real(found, "the source"), "the source")
        if values.shape not in ((), x.shape):
            raise BadValues(f"the source has answered with the shape {values.shape} for points of shape {x.shape}")
        return np.broadcast_to(values, x.shape)


def functional_of_degree_2(
    parts: MeshParts, equation: Equation, places: Places, u: Array, is_fixed: npt.NDArray[np.bool_]
) -> float:
    """The functional of the solution of degree 2, with the values of ``u`` at the nodes that are fixed.

    Nothing flows through the rest of the boundary. Raises :class:`BadValues` where the equations are singular.
    """
    solver = library("scipy.sparse.linalg", install="pip install scipy", package="scipy")
    edges, numbers = unique_edges(parts.cells)
    on_boundary = np.bincount(numbers.ravel(), minlength=len(edges)) == 1
    given = on_boundary & is_fixed[edges].all(axis=1)
    count, middles = len(parts.points), parts.points[edges].mean(axis=1)
    point = parts.cells[places.cells] if places.cells.size == 1 else parts.cells[:0]
    for corner in np.setdiff1d(steep_corners(parts, edges[on_boundary], given[on_boundary]), point):
        for end in (0, 1):
            at = np.flatnonzero(edges[:, end] == corner)
            ends = parts.points[edges[at, 1 - end]]
            middles[at] = parts.points[corner] + NEAR_CORNER * (ends - parts.points[corner])
    centres = 0.5 * middles[numbers].sum(axis=1) - 0.25 * parts.points[parts.cells].sum(axis=1)
    points = np.concatenate([parts.points, middles, centres])
    last = count + len(edges) + np.arange(len(parts.cells))
    nodes = np.concatenate([parts.cells, count + numbers, last[:, None]], axis=1)
    matrix, load = assembled(points, nodes, equation)
    values = np.zeros(len(points))
    known = np.concatenate([is_fixed, given, np.zeros(len(parts.cells), dtype=bool)])
    values[:count][is_fixed] = u[is_fixed]
    values[count : count + len(edges)][given] = on_middles(parts.points, edges[given], u)
    free = np.flatnonzero(~known)
    rows = matrix[free]
    try:
        values[free] = solver.splu(rows[:, free].tocsc()).solve(load[free] - rows @ values)
    except RuntimeError as error:
        raise BadValues(f"the equations are singular ({error}): name the nodes with given values in fixed") from error
    return float(places.on(nodes, len(points), quadratic_functions) @ values)


def steep_corners(parts: MeshParts, edges: IntArray, given: npt.NDArray[np.bool_]) -> IntArray:
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


def on_middles(points: Array, edges: IntArray, u: Array) -> Array:
    """Given values at the middles of ``edges``: by parabolas through three nodes, where the side goes straight on."""
    found = u[edges].mean(axis=1)
    steps = points[edges[:, 1]] - points[edges[:, 0]]
    lengths, slopes = np.hypot(*steps.T), u[edges[:, 1]] - u[edges[:, 0]]
    at: dict[int, list[int]] = {}
    for number, pair in enumerate(edges.tolist()):
        for node in pair:
            at.setdefault(node, []).append(number)
    bends: list[list[float]] = [[] for _ in edges]
    for node, both in at.items():
        if len(both) != 2:
            continue
        signs = [1.0 if edges[one, 0] == node else -1.0 for one in both]
        lower, upper = lengths[both]
        cosine = -signs[0] * signs[1] * float(steps[both[0]] @ steps[both[1]]) / (lower * upper)
        if cosine > LEAST_COSINE:
            rise = signs[0] * slopes[both[0]] / lower + signs[1] * slopes[both[1]] / upper
            for one in both:
                bends[one].append(rise / (lower + upper))
    bend = np.array([float(np.mean(one)) if one else 0.0 for one in bends])
    return np.asarray(found - 0.25 * lengths**2 * bend)


def quadratic_functions(s: Any, t: Any) -> Array:
    """The nine biquadratic shape functions, in the order of ``NODES``."""
    along, across = (_quadratics(q)[0] for q in (s, t))
    return np.stack([along[i] * across[j] for i, j in NODES])


def _quadratics(s: Any) -> tuple[Array, Array]:
    """The three quadratic shape functions of an interval, and their derivatives."""
    return np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)]), np.stack(
        [4 * s - 3, 4 - 8 * s, 4 * s - 1]
    )


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


def _rule(count: int) -> list[tuple[Array, Array, Array, float]]:
    """Shape functions, their derivatives along s and t, and the weight, at the points of a Gauss rule."""
    at, share = np.polynomial.legendre.leggauss(count)
    found = []
    for s, p in zip(0.5 * (at + 1.0), 0.5 * share, strict=True):
        for t, q in zip(0.5 * (at + 1.0), 0.5 * share, strict=True):
            (one, d_one), (other, d_other) = _quadratics(s), _quadratics(t)
            parts = ([a[i] * b[j] for i, j in NODES] for a, b in ((one, other), (d_one, other), (one, d_other)))
            found.append((*(np.array(part) for part in parts), float(p * q)))
    return found  # type: ignore[return-value]


def _slopes(of_cells: Array, along: Array, across: Array) -> tuple[Array, Array, Array]:
    """The determinant of the map of each cell, and the derivatives of shape functions by x and y, ``(m, 9)``."""
    x_s, y_s = (of_cells[..., k] @ along for k in (0, 1))
    x_t, y_t = (of_cells[..., k] @ across for k in (0, 1))
    det = x_s * y_t - x_t * y_s
    x = (y_t[:, None] * along - y_s[:, None] * across) / det[:, None]
    y = (x_s[:, None] * across - x_t[:, None] * along) / det[:, None]
    return det, x, y
