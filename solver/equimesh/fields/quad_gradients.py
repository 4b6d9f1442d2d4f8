"""Gradients of u at the nodes of a mesh of quadrilaterals, from differences of the nodal values along its edges."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.quad_links import MAX_SPOKES, QuadLinks, spokes_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, Pair

MAX_TURNS = (0.1, 0.8)
"""The largest turn of a line at a node, in radians, at which its derivatives are those of a parabola.

First only nodes with small turns have a gradient and give it to their neighbours, then those with larger ones.
"""
MIN_SINE = 0.02
"""The smallest sine of the angle between two directions that give a gradient together."""
MIN_FIT_SINE = 0.3
"""The same for a gradient that is fitted to the slopes along edges."""
ROUNDS = 2
"""How often the gradients that are still missing are sought by those of neighbours."""


def quad_gradients(nodes: Pair, links: QuadLinks, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes of a valid mesh; x and y of the ``nodes`` and ``values`` have the shape ``(n,)``.

    Where four cells meet and both lines through the node are nearly straight, the gradient is that of
    :func:`~equimesh.fields.nodal_gradients.nodal_gradients`, which is exact for linear functions, and has an error of
    O(h^2) for smooth u on smooth lines. Elsewhere, as at a side, at a kink of the lines, and where three or five cells
    meet, u is taken as quadratic along each edge: the change of u is the mean of the two slopes at its ends, of which
    one is known. The gradient fits these slopes best. Where too few are known, it is the mean of those in the cells
    around the node, by area.
    """
    gradients = np.zeros((2, values.size))
    known = np.zeros(values.size, dtype=np.bool_)
    for turn in MAX_TURNS:
        along_lines(nodes, links, values, np.cos(turn), (gradients, known))
        for _ in range(ROUNDS):
            if from_neighbours(nodes, links, values, np.cos(turn), (gradients, known)) == 0:
                break
    mean_of_cells(nodes, links, values, gradients, known)
    return gradients[0], gradients[1]


@compiled
def slope_along(nodes: Pair, values: Array, before: int, node: int, after: int, slopes: Array) -> float:
    """The derivatives of x, y and u by the length of the line through three nodes, at the middle one, in ``slopes``.

    Returns the cosine of the turn of the line.
    """
    x, y = nodes
    ax, ay, bx, by = x[node] - x[before], y[node] - y[before], x[after] - x[node], y[after] - y[node]
    a, b = np.hypot(ax, ay), np.hypot(bx, by)
    share = a / (a + b)
    slopes[0] = (1.0 - share) * (ax / a) + share * (bx / b)
    slopes[1] = (1.0 - share) * (ay / a) + share * (by / b)
    slopes[2] = (1.0 - share) * ((values[node] - values[before]) / a) + share * ((values[after] - values[node]) / b)
    return float((ax * bx + ay * by) / (a * b))


@compiled
def along_lines(nodes: Pair, links: QuadLinks, values: Array, straight: float, found: tuple[Array, BoolArray]) -> None:
    """Fill in missing gradients where two lines meet whose turns have a cosine of at least ``straight``."""
    gradients, known = found
    spokes, one, other = np.empty(MAX_SPOKES, dtype=np.int64), np.empty(3), np.empty(3)
    for node in range(values.size):
        if known[node] or links.starts[node + 1] - links.starts[node] != 4:
            continue
        count, closed = spokes_of(node, links, spokes)
        if not (closed and count == 4):
            continue
        if slope_along(nodes, values, spokes[0], node, spokes[2], one) < straight:
            continue
        if slope_along(nodes, values, spokes[1], node, spokes[3], other) < straight:
            continue
        det = one[0] * other[1] - one[1] * other[0]
        if abs(det) < MIN_SINE * np.hypot(one[0], one[1]) * np.hypot(other[0], other[1]):
            continue
        gradients[0, node] = (one[2] * other[1] - other[2] * one[1]) / det
        gradients[1, node] = (other[2] * one[0] - one[2] * other[0]) / det
        known[node] = True


@compiled
def from_neighbours(
    nodes: Pair, links: QuadLinks, values: Array, straight: float, found: tuple[Array, BoolArray]
) -> int:
    """Fill in missing gradients by those that are known before; returns how many were found."""
    (x, y), (gradients, known) = nodes, found
    spokes, line, new = np.empty(MAX_SPOKES, dtype=np.int64), np.empty(3), np.zeros(values.size, dtype=np.bool_)
    number = 0
    for node in range(values.size):
        if known[node] or links.starts[node + 1] == links.starts[node]:
            continue
        count, closed = spokes_of(node, links, spokes)
        a = b = d = p = q = 0.0  # the normal equations of all slopes by directions of length 1
        for k in range(count):
            to = spokes[k]
            if known[to]:
                ex, ey = x[to] - x[node], y[to] - y[node]
                length = np.hypot(ex, ey)
                ex, ey = ex / length, ey / length
                slope = 2.0 * (values[to] - values[node]) / length - gradients[0, to] * ex - gradients[1, to] * ey
                a, b, d, p, q = a + ex * ex, b + ex * ey, d + ey * ey, p + slope * ex, q + slope * ey
        if count == (4 if closed else 3):
            for k in range(count - 2):
                if slope_along(nodes, values, spokes[k], node, spokes[k + 2], line) >= straight:
                    ex, ey, slope = line[0], line[1], line[2]
                    a, b, d, p, q = a + ex * ex, b + ex * ey, d + ey * ey, p + slope * ex, q + slope * ey
        det = a * d - b * b
        if det > MIN_FIT_SINE * MIN_FIT_SINE:
            gradients[0, node], gradients[1, node] = (d * p - b * q) / det, (a * q - b * p) / det
            new[node] = True
            number += 1
    for node in range(values.size):
        known[node] = known[node] or new[node]
    return number


@compiled
def mean_of_cells(nodes: Pair, links: QuadLinks, values: Array, gradients: Array, known: BoolArray) -> None:
    """Fill in what is missing still: the mean of the gradients in the cells around the node, by area."""
    x, y = nodes
    for node in range(values.size):
        if known[node]:
            continue
        g = h = area = 0.0
        for at in range(links.starts[node], links.starts[node + 1]):
            c = links.cells[links.places[at] // 4]
            ax, ay, bx, by = x[c[2]] - x[c[0]], y[c[2]] - y[c[0]], x[c[3]] - x[c[1]], y[c[3]] - y[c[1]]
            u, v = values[c[2]] - values[c[0]], values[c[3]] - values[c[1]]
            # By Green's formula the integral of the gradient; the area is half of the product.
            g, h, area = g + u * by - v * ay, h + v * ax - u * bx, area + ax * by - ay * bx
        if area > 0.0:
            gradients[0, node], gradients[1, node] = g / area, h / area
