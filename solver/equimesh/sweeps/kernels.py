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
from equimesh.numerics.types import Array, IntArray, SingleArray


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


# Compiled loops over closed grid lines: corrections that keep the mean position of every line.
#
# Equal metric lengths leave one freedom to a closed line: its nodes may run on along it. A constant is added to the
# running sum of the line's defects, P or Q, such that the mean coordinate along the line becomes that of the uniform
# mesh. Where the sum is C and the node moves by ``dx`` per unit of it, the constant is ``-(offset + sum(C dx)) /
# sum(dx)``. The result does not depend on where a line begins.
#
# The arrays of a closed direction begin and end with copies of the nodes on the other side, moved by 1.


@compiled
def closed_side_moves(sides: SidePair, strength: tuple[float, float], flux: Array, moves: Array) -> tuple[float, float]:
    """Corrections ``moves`` of the nodes along two opposite sides that are closed lines, and the ``flux`` of edges.

    Both have a copy of a node at either end. Returns as :func:`~equimesh.sweeps.kernels.side_moves`.
    """
    t, u, u_n, base = sides
    a2, b = strength
    n = t.shape[1]
    edges = n - 2
    deviation, largest = 0.0, 0.0
    for side in range(2):
        total = 0.0
        for e in range(n - 1):
            d, du, normal = t[side, e + 1] - t[side, e], u[side, e + 1] - u[side, e], u_n[side, e + 1] + u_n[side, e]
            b11, b12, b22 = base[0, side, e], base[1, side, e], base[2, side, e]
            g, h = du / d, 0.5 * normal
            square = (b22 * g * g - 2.0 * b12 * g * h + b11 * h * h) / (b11 * b22 - b12 * b12)
            flux[side, e] = b11 * d * d + a2 / (1.0 + b * square) * du * du
            if e > 0:
                total += flux[side, e]
        mean = total / edges
        running, offset, weights = 0.0, 0.0, 0.0
        for e in range(1, n - 1):
            before, after = t[side, e] - t[side, e - 1], t[side, e + 1] - t[side, e]
            weight = 1.0 / (flux[side, e - 1] / before + flux[side, e] / after)
            moves[side, e] = -running * weight
            offset += t[side, e] + moves[side, e] - (e - 1) / edges
            weights += weight
            difference = flux[side, e] - mean
            running += difference
            deviation = max(deviation, abs(difference) / mean)
            if difference - difference != 0.0:
                deviation = np.inf
        for e in range(1, n - 1):
            before, after = t[side, e] - t[side, e - 1], t[side, e + 1] - t[side, e]
            weight = 1.0 / (flux[side, e - 1] / before + flux[side, e] / after)
            moves[side, e] -= offset / weights * weight
            largest = max(largest, abs(moves[side, e]))
        moves[side, 0], moves[side, n - 1] = moves[side, n - 2], moves[side, 1]
    return deviation, largest


@vectorised
def closed_eta_corrections(
    nodes: Nodes, m: Array, strip: Strip, out: Moved, along_q: SingleArray, sums: Array
) -> float:
    """As :func:`~equimesh.sweeps.kernels.eta_corrections` for eta-lines that are closed.

    The running sum of every line begins with 0; :func:`closed_xi_corrections` adds the constant. ``along_q`` of shape
    ``(2, n_xi, n_eta)`` receives the move per ``-2 Q``.
    """
    x, y = nodes
    first, last, summed = strip
    n_eta = x.shape[1]
    edges = n_eta - 2
    flux, running = np.empty(n_eta), np.empty(n_eta)
    deviation = 0.0
    for j in range(n_eta):
        sums[j] = 0.0
    for i in range(first, last):
        c = i - first
        x1, y1 = x[i], y[i]
        a11, a12, a22, b11, b12, b22 = m[0, c], m[1, c], m[2, c], m[0, c + 1], m[1, c + 1], m[2, c + 1]
        total = 0.0
        for j in range(1, n_eta - 1):
            fx, fy = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            flux[j] = 0.5 * (
                (a11[j] + b11[j]) * fx * fx + 2.0 * (a12[j] + b12[j]) * fx * fy + (a22[j] + b22[j]) * fy * fy
            )
            total += flux[j]
        level, largest = total / edges, 0.0
        for j in range(1, n_eta - 1):
            largest = max(largest, abs(flux[j] - level))
        deviation = max(deviation, largest / level)
        sum_so_far = 0.0
        running[1] = 0.0
        for j in range(2, n_eta - 1):
            sum_so_far += flux[j - 1] - level
            running[j] = sum_so_far
        closed_row(nodes, m, i, c, running, out, along_q)
        if i < summed:
            square = out.squares[i]
            for j in range(1, n_eta - 1):
                sums[j] += square[j]
    return deviation


@inlined
def closed_row(nodes: Nodes, m: Array, i: int, c: int, running: Array, out: Moved, along_q: SingleArray) -> None:
    """As :func:`~equimesh.sweeps.kernels.move_row`, with the move per ``-2 Q`` for ``along_q``."""
    x, y = nodes
    n_eta = x.shape[1]
    x0, x1, x2, y0, y1, y2 = x[i - 1], x[i], x[i + 1], y[i - 1], y[i], y[i + 1]
    a11, a12, a22, b11, b12, b22 = m[0, c], m[1, c], m[2, c], m[0, c + 1], m[1, c + 1], m[2, c + 1]
    row_x, row_y, p_x, p_y, square = out.x[i], out.y[i], out.along_p[0, i], out.along_p[1, i], out.squares[i]
    q_x, q_y = along_q[0, i], along_q[1, i]
    for j in range(1, n_eta - 1):
        b_11, b_12, b_22 = b11[j - 1] + b11[j], b12[j - 1] + b12[j], b22[j - 1] + b22[j]
        p11 = 0.25 * (a11[j - 1] + a11[j] + b_11)
        p12 = 0.25 * (a12[j - 1] + a12[j] + b_12)
        p22 = 0.25 * (a22[j - 1] + a22[j] + b_22)
        ex, ey = 0.5 * (x2[j] - x0[j]), 0.5 * (y2[j] - y0[j])
        fx, fy = 0.5 * (x1[j + 1] - x1[j - 1]), 0.5 * (y1[j + 1] - y1[j - 1])
        a, b, c_, d = p11 * ex + p12 * ey, p12 * ex + p22 * ey, p11 * fx + p12 * fy, p12 * fx + p22 * fy
        inverse = -0.5 / (a * d - b * c_)
        by_x, by_y = -b * inverse, a * inverse
        row_x[j] = x1[j] + by_x * running[j]
        row_y[j] = y1[j] + by_y * running[j]
        q_x[j], q_y[j] = by_x, by_y
        p_x[j] = d * inverse
        p_y[j] = -c_ * inverse
        gx, gy = x2[j] - x1[j], y2[j] - y1[j]
        square[j] = 0.5 * (b_11 * gx * gx + 2.0 * b_12 * gx * gy + b_22 * gy * gy)


@vectorised
def closed_xi_corrections(
    nodes: Nodes, strip: Strip, levels: Levels, running: Array, out: Moved, along_q: SingleArray, largest: Array
) -> None:
    """As :func:`~equimesh.sweeps.kernels.xi_corrections`, and close the eta-lines.

    The mean of y along every eta-line becomes that of the uniform mesh.
    """
    x, y = nodes
    mean, shift = levels
    n_eta = x.shape[1]
    deviation, move = 0.0, 0.0
    for i in range(strip.first, strip.last):
        old_x, old_y, row_x, row_y = x[i], y[i], out.x[i], out.y[i]
        p_x, p_y, square = out.along_p[0, i], out.along_p[1, i], out.squares[i]
        by_x, by_y = along_q[0, i], along_q[1, i]
        offset, weights = -0.5 * (n_eta - 3), 0.0  # the sum of y along a line of the uniform mesh
        for j in range(1, n_eta - 1):
            row_x[j] += p_x[j] * running[j]
            row_y[j] += p_y[j] * running[j]
            offset += row_y[j]
            weights += by_y[j]
            running[j] += square[j] - mean[j] + shift[j]
        constant = -offset / weights
        for j in range(1, n_eta - 1):
            row_x[j] += by_x[j] * constant
            row_y[j] += by_y[j] * constant
            move = max(move, abs(row_x[j] - old_x[j]), abs(row_y[j] - old_y[j]))
        if i < strip.summed:
            for j in range(1, n_eta - 1):
                deviation = max(deviation, abs(square[j] - mean[j]) / mean[j])
    largest[0], largest[1] = deviation, move


@vectorised
def closing_sums(strip: Strip, edges: int, out: Moved, sums: Array) -> None:
    """What a strip of node rows adds to the mean of x along closed xi-lines, in ``sums`` of shape ``(4, n_eta)``.

    The sums over the rows of: the move of x per ``-2 P``; that times the running sum of squared metric lengths from
    the first row of the strip; that times the number of rows from there; and x without the corrections of the
    xi-lines, less that of the uniform mesh with ``edges`` edges.
    """
    first, last, _ = strip
    weights, running, rows, offset = sums[0], sums[1], sums[2], sums[3]
    n_eta = sums.shape[1]
    so_far = np.zeros(n_eta)
    for j in range(n_eta):
        weights[j] = running[j] = rows[j] = offset[j] = 0.0
    for i in range(first, last):
        p_x, square, row_x, count, place = out.along_p[0, i], out.squares[i], out.x[i], i - first, (i - 1) / edges
        for j in range(1, n_eta - 1):
            weights[j] += p_x[j]
            running[j] += p_x[j] * so_far[j]
            rows[j] += p_x[j] * count
            offset[j] += row_x[j] - place
            so_far[j] += square[j]


@compiled
def close_lines(closings: Array, levels: Levels, starts: Array) -> None:
    """Add the constants of closed xi-lines to their ``starts`` in every strip.

    ``closings`` of shape ``(strips, 4, n_eta)`` are the sums of :func:`closing_sums`.
    """
    strips = starts.shape[0]
    for j in range(1, starts.shape[1] - 1):
        moved, weights = 0.0, 0.0
        for k in range(strips):
            weight, running, rows, offset = closings[k, 0, j], closings[k, 1, j], closings[k, 2, j], closings[k, 3, j]
            moved += offset + running + rows * (levels.shift[j] - levels.mean[j]) + starts[k, j] * weight
            weights += weight
        for k in range(strips):
            starts[k, j] -= moved / weights


@compiled
def copy_ends(q: Array, axis: int, period: float) -> None:
    """Write the outermost rows (``axis`` 0) or columns (1) of nodal values: those of the other side, less or more."""
    if axis == 0:
        last = q.shape[0] - 1
        for j in range(q.shape[1]):
            q[0, j], q[last, j] = q[last - 1, j] - period, q[1, j] + period
        return
    last = q.shape[1] - 1
    for i in range(q.shape[0]):
        q[i, 0], q[i, last] = q[i, last - 1] - period, q[i, 1] + period
