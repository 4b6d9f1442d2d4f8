"""Compiled loops over closed grid lines: corrections that keep the mean position of every line.

Equal metric lengths leave one freedom to a closed line: its nodes may run on along it. A constant is added to the
running sum of the line's defects, P or Q, such that the mean coordinate along the line becomes that of the uniform
mesh. Where the sum is C and the node moves by ``dx`` per unit of it, the constant is ``-(offset + sum(C dx)) /
sum(dx)``. The result does not depend on where a line begins.

The arrays of a closed direction begin and end with copies of the nodes on the other side, moved by 1.
"""

from __future__ import annotations

import numpy as np

from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, SingleArray
from equimesh.sweeps.kernels import Levels, Moved, Nodes, SidePair, Strip


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
