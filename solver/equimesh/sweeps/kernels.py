"""Compiled loops over a mesh: cell metrics, one sweep of line corrections, and sums of squared metric lengths.

All arrays are C-contiguous, of shape ``(n_xi, n_eta)`` unless another one is given. Coordinate differences are not
divided by the spacing: a flux here is the squared metric length of an edge. The kernels hold no interpreter lock, are
compiled once per machine, and call no user code. A kernel that works on some rows of a mesh touches no others, so that
threads can share the rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, IntArray


class Nodes(NamedTuple):
    """The positions of all nodes of a mesh."""

    x: Array
    y: Array


class Strip(NamedTuple):
    """The node rows ``first`` to ``last - 1``; the xi-edges from rows below ``summed`` belong to the xi-lines."""

    first: int
    last: int
    summed: int


class Lines(NamedTuple):
    """Grid lines of one direction, from node ``first`` to ``last``, and their continuation outside the window.

    Outside, ``beyond`` edges follow at the lower and the upper end. ``rest`` of shape ``(2, lines)`` holds the sums of
    their squared metric lengths. ``push``, of the same shape, is ``-2 P`` or ``-2 Q`` that an end of the line outside
    the window adds, since it moves; :func:`side_moves` does not use it.
    """

    first: int
    last: int
    rest: Array
    beyond: tuple[float, float]
    push: Array


class Levels(NamedTuple):
    """For each xi-line, ``(n_eta,)``: the ``mean`` squared metric length of its edges, and the ``shift``.

    ``-2 P`` grows by the shift from row to row, because the sides move.
    """

    mean: Array
    shift: Array


class SidePair(NamedTuple):
    """Nodes along two opposite sides: their positions ``t``, u and the normal derivative ``u_n``, of shape ``(2, n)``.

    ``base`` of shape ``(3, 2, n - 1)`` is the pointwise part of the metric at the middles of the edges, its tangential
    entry first.
    """

    t: Array
    u: Array
    u_n: Array
    base: Array


class Moved(NamedTuple):
    """The results of a sweep: the new positions ``x`` and ``y``, and data for the corrections of the xi-lines.

    ``along_p`` of shape ``(2, n_xi, n_eta)`` is the move per ``-2 P``, ``squares[i]`` the squared metric lengths of the
    xi-edges from row i.
    """

    x: Array
    y: Array
    along_p: Array
    squares: Array


@vectorised
def arc_length_cells(x: Array, y: Array, u: Array, a2: float, b: float, m: Array) -> None:
    """The arc-length metric of the cells between the rows of nodes, in ``m`` of shape ``(3, rows - 1, n_eta - 1)``."""
    rows, n_eta = x.shape
    for i in range(rows - 1):
        x0, x1, y0, y1, u0, u1 = x[i], x[i + 1], y[i], y[i + 1], u[i], u[i + 1]
        m11, m12, m22 = m[0, i], m[1, i], m[2, i]
        for j in range(n_eta - 1):
            # The sum and the difference of the two mean edges are the diagonals of the cell.
            dx, dy, du = x1[j + 1] - x0[j], y1[j + 1] - y0[j], u1[j + 1] - u0[j]
            ox, oy, ou = x1[j] - x0[j + 1], y1[j] - y0[j + 1], u1[j] - u0[j + 1]
            inverse = 1.0 / (ox * dy - dx * oy)
            gx, gy = (ou * dy - du * oy) * inverse, (ox * du - dx * ou) * inverse
            k = a2 / (1.0 + b * (gx * gx + gy * gy))
            m11[j] = 1.0 + k * gx * gx
            m12[j] = k * gx * gy
            m22[j] = 1.0 + k * gy * gy


@vectorised
def arc_length_cells_on(x: Array, y: Array, u: Array, a2: float, b: float, m: Array) -> None:
    """As :func:`arc_length_cells` on a domain: ``m`` first holds the metric of its map, then the sum of both."""
    rows, n_eta = x.shape
    for i in range(rows - 1):
        x0, x1, y0, y1, u0, u1 = x[i], x[i + 1], y[i], y[i + 1], u[i], u[i + 1]
        m11, m12, m22 = m[0, i], m[1, i], m[2, i]
        for j in range(n_eta - 1):
            dx, dy, du = x1[j + 1] - x0[j], y1[j + 1] - y0[j], u1[j + 1] - u0[j]
            ox, oy, ou = x1[j] - x0[j + 1], y1[j] - y0[j + 1], u1[j] - u0[j + 1]
            inverse = 1.0 / (ox * dy - dx * oy)
            gx, gy = (ou * dy - du * oy) * inverse, (ox * du - dx * ou) * inverse
            b11, b12, b22 = m11[j], m12[j], m22[j]
            square = (b22 * gx * gx - 2.0 * b12 * gx * gy + b11 * gy * gy) / (b11 * b22 - b12 * b12)
            k = a2 / (1.0 + b * square)
            m11[j] = b11 + k * gx * gx
            m12[j] = b12 + k * gx * gy
            m22[j] = b22 + k * gy * gy


@compiled
def side_moves(
    sides: SidePair, strength: tuple[float, float], physical: tuple[bool, bool], lines: Lines, flux: Array, moves: Array
) -> tuple[float, float]:
    """Corrections ``moves`` of the nodes along two opposite sides, of shape ``(2, n)``, and the ``flux`` of edges.

    ``strength`` is ``a^2`` and ``b`` of the arc length. Sides that are not ``physical`` are left alone. Returns the
    largest relative deviation of a flux from the mean of its line, and the largest move.
    """
    t, u, u_n, base = sides
    a2, b = strength
    first, last, rest, beyond, _ = lines
    n = t.shape[1]
    deviation, largest = 0.0, 0.0
    for side in range(2):
        if not physical[side]:
            continue
        total = rest[0, side] + rest[1, side]
        for e in range(n - 1):
            d, du, normal = t[side, e + 1] - t[side, e], u[side, e + 1] - u[side, e], u_n[side, e + 1] + u_n[side, e]
            b11, b12, b22 = base[0, side, e], base[1, side, e], base[2, side, e]
            g, h = du / d, 0.5 * normal
            square = (b22 * g * g - 2.0 * b12 * g * h + b11 * h * h) / (b11 * b22 - b12 * b12)
            flux[side, e] = b11 * d * d + a2 / (1.0 + b * square) * du * du
            if first <= e < last:
                total += flux[side, e]
        mean = total / (last - first + beyond[0] + beyond[1])
        running = rest[0, side] - beyond[0] * mean
        moves[side, :] = 0.0
        for e in range(first, n - 1):
            if e > 0:
                # The flux over the edge length is the metric times the tangent, here at the node between two edges.
                before, after = t[side, e] - t[side, e - 1], t[side, e + 1] - t[side, e]
                moves[side, e] = -running / (flux[side, e - 1] / before + flux[side, e] / after)
                largest = max(largest, abs(moves[side, e]))
            if e == last:
                break
            difference = flux[side, e] - mean
            running += difference
            deviation = max(deviation, abs(difference) / mean)
            if difference - difference != 0.0:
                deviation = np.inf
    return deviation, largest


@vectorised
def end_edges(x: Array, y: Array, m: Array, row: int, moved: Array, push: Array, squares: Array) -> None:
    """The row of xi-edges at one end of the mesh: its first (``row`` 0) or last (``row`` -1) cells.

    ``squares`` receives the squared metric lengths of the first edges only. ``push`` receives ``-2 P`` on the side,
    whose nodes move by ``moved`` along it.
    """
    n_eta = x.shape[1]
    node = 0 if row == 0 else x.shape[0] - 2
    m11, m12, m22 = m[0, row], m[1, row], m[2, row]
    for j in range(1, n_eta - 1):
        gx, gy = x[node + 1, j] - x[node, j], y[node + 1, j] - y[node, j]
        p11, p12, p22 = 0.5 * (m11[j - 1] + m11[j]), 0.5 * (m12[j - 1] + m12[j]), 0.5 * (m22[j - 1] + m22[j])
        push[j] = -2.0 * (p12 * gx + p22 * gy) * moved[j]
        if row == 0:
            squares[j] = p11 * gx * gx + 2.0 * p12 * gx * gy + p22 * gy * gy


@vectorised
def eta_corrections(nodes: Nodes, m: Array, strip: Strip, moved: Array, lines: Lines, out: Moved, sums: Array) -> float:
    """Correct the eta-lines of a strip of node rows, and prepare the corrections of the xi-lines.

    ``m`` holds the cell rows from ``strip.first - 1`` on, ``moved`` of shape ``(2, n_xi)`` the moves of the bottom and
    top nodes along xi. ``out`` receives the nodes moved by the part of the correction due to Q, ``sums`` the sums of
    ``out.squares`` over the rows below ``strip.summed``. Returns the largest relative deviation along the lines.
    """
    x, y = nodes
    first, last, summed = strip
    bottom, top, rest, beyond, push = lines
    n_eta = x.shape[1]
    edges = top - bottom + beyond[0] + beyond[1]
    flux, running = np.empty(n_eta), np.empty(n_eta)
    deviation = 0.0
    for j in range(n_eta):
        sums[j] = 0.0
    for i in range(first, last):
        c = i - first
        x1, y1 = x[i], y[i]
        a11, a12, a22, b11, b12, b22 = m[0, c], m[1, c], m[2, c], m[0, c + 1], m[1, c + 1], m[2, c + 1]
        total = rest[0, i] + rest[1, i]
        for j in range(bottom, top):
            fx, fy = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            flux[j] = 0.5 * (
                (a11[j] + b11[j]) * fx * fx + 2.0 * (a12[j] + b12[j]) * fx * fy + (a22[j] + b22[j]) * fy * fy
            )
            total += flux[j]
        level, largest = total / edges, 0.0
        for j in range(bottom, top):
            largest = max(largest, abs(flux[j] - level))
        deviation = max(deviation, largest / level)
        # -2 Q on the bottom and on the top, and the running sum between them.
        e, z = n_eta - 2, n_eta - 1
        start = -((a11[0] + b11[0]) * (x1[1] - x1[0]) + (a12[0] + b12[0]) * (y1[1] - y1[0])) * moved[0, i]
        end = -((a11[e] + b11[e]) * (x1[z] - x1[e]) + (a12[e] + b12[e]) * (y1[z] - y1[e])) * moved[1, i]
        start += push[0, i]
        end += push[1, i]
        level -= (end - start) / edges
        sum_so_far = start + rest[0, i] - beyond[0] * level
        running[bottom] = sum_so_far
        for j in range(bottom + 1, n_eta - 1):
            sum_so_far += flux[j - 1] - level
            running[j] = sum_so_far
        move_row(nodes, m, i, c, running, out)
        if i < summed:
            square = out.squares[i]
            for j in range(1, n_eta - 1):
                sums[j] += square[j]
    return deviation


@inlined
def move_row(nodes: Nodes, m: Array, i: int, c: int, running: Array, out: Moved) -> None:
    """Node row ``i`` of :func:`eta_corrections`, between cell rows ``c`` and ``c + 1``; ``running`` is its ``-2 Q``."""
    x, y = nodes
    n_eta = x.shape[1]
    x0, x1, x2, y0, y1, y2 = x[i - 1], x[i], x[i + 1], y[i - 1], y[i], y[i + 1]
    a11, a12, a22, b11, b12, b22 = m[0, c], m[1, c], m[2, c], m[0, c + 1], m[1, c + 1], m[2, c + 1]
    row_x, row_y, p_x, p_y, square = out.x[i], out.y[i], out.along_p[0, i], out.along_p[1, i], out.squares[i]
    for j in range(1, n_eta - 1):
        p11 = 0.25 * (a11[j - 1] + a11[j] + b11[j - 1] + b11[j])
        p12 = 0.25 * (a12[j - 1] + a12[j] + b12[j - 1] + b12[j])
        p22 = 0.25 * (a22[j - 1] + a22[j] + b22[j - 1] + b22[j])
        ex, ey = 0.5 * (x2[j] - x0[j]), 0.5 * (y2[j] - y0[j])
        fx, fy = 0.5 * (x1[j + 1] - x1[j - 1]), 0.5 * (y1[j + 1] - y1[j - 1])
        a, b, c_, d = p11 * ex + p12 * ey, p12 * ex + p22 * ey, p11 * fx + p12 * fy, p12 * fx + p22 * fy
        inverse = -0.5 / (a * d - b * c_)
        row_x[j] = x1[j] - b * inverse * running[j]
        row_y[j] = y1[j] + a * inverse * running[j]
        p_x[j] = d * inverse
        p_y[j] = -c_ * inverse
        gx, gy = x2[j] - x1[j], y2[j] - y1[j]
        square[j] = 0.5 * (
            (b11[j - 1] + b11[j]) * gx * gx + 2.0 * (b12[j - 1] + b12[j]) * gx * gy + (b22[j - 1] + b22[j]) * gy * gy
        )


@vectorised
def xi_corrections(nodes: Nodes, strip: Strip, levels: Levels, running: Array, out: Moved, largest: Array) -> None:
    """Add the corrections of the xi-lines to the node rows of a strip in ``out``.

    ``running`` is ``-2 P`` at the first row, and is continued. ``largest`` receives the largest relative deviation
    from the mean in the rows below ``strip.summed``, and the largest move of a coordinate.
    """
    x, y = nodes
    first, last, summed = strip
    mean, shift = levels
    new_x, new_y, along_p, squares = out
    n_eta = x.shape[1]
    deviation, move = 0.0, 0.0
    for i in range(first, last):
        old_x, old_y, row_x, row_y = x[i], y[i], new_x[i], new_y[i]
        p_x, p_y, square = along_p[0, i], along_p[1, i], squares[i]
        for j in range(1, n_eta - 1):
            row_x[j] += p_x[j] * running[j]
            row_y[j] += p_y[j] * running[j]
            move = max(move, abs(row_x[j] - old_x[j]), abs(row_y[j] - old_y[j]))
            running[j] += square[j] - mean[j] + shift[j]
        if i < summed:
            for j in range(1, n_eta - 1):
                deviation = max(deviation, abs(square[j] - mean[j]) / mean[j])
    largest[0], largest[1] = deviation, move


@vectorised
def segment_sums(
    nodes: Nodes, m: Array, rows: tuple[int, int], cuts: IntArray, along_xi: Array, along_eta: Array
) -> None:
    """Sums of the squared metric lengths of the edges from node rows ``rows[0]`` to ``rows[1] - 1``.

    ``m`` holds the cell rows that meet in these node rows. ``along_xi[j]`` receives the sum of the xi-edges that begin
    in the rows, ``along_eta[s, i]`` that of the eta-edges of row i between the nodes ``cuts[s]`` and ``cuts[s + 1]``.
    """
    x, y = nodes
    begin, last = rows
    n_eta = x.shape[1]
    first = max(begin, 1)
    for j in range(n_eta):
        along_xi[j] = 0.0
    for i in range(begin, last):
        b11, b12, b22 = m[0, i - first + 1], m[1, i - first + 1], m[2, i - first + 1]
        x1, x2, y1, y2 = x[i], x[i + 1], y[i], y[i + 1]
        for j in range(1, n_eta - 1):
            gx, gy = x2[j] - x1[j], y2[j] - y1[j]
            along_xi[j] += 0.5 * (
                (b11[j - 1] + b11[j]) * gx * gx
                + 2.0 * (b12[j - 1] + b12[j]) * gx * gy
                + (b22[j - 1] + b22[j]) * gy * gy
            )
        if i == 0:
            continue
        a11, a12, a22 = m[0, i - first], m[1, i - first], m[2, i - first]
        for s in range(cuts.shape[0] - 1):
            total = 0.0
            for j in range(cuts[s], cuts[s + 1]):
                fx, fy = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
                total += 0.5 * (
                    (a11[j] + b11[j]) * fx * fx + 2.0 * (a12[j] + b12[j]) * fx * fy + (a22[j] + b22[j]) * fy * fy
                )
            along_eta[s, i] = total
