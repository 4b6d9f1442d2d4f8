"""The curve that a line of boundary nodes lies on: straight, a circle, or else a spline through the nodes."""

from __future__ import annotations

import numpy as np

from equimesh.blocks.curves import BoundaryCurve, Circle, Line
from equimesh.blocks.recovery.boundary import Line as NodeLine
from equimesh.blocks.spline_curve import SplineCurve, as_points
from equimesh.numerics.types import Array

# Nodes lie on a line or a circle where they are nearer to it than this part of the size of the mesh.
ON_CURVE: float = 1e-9
# Nodes that a circle is recognised by, at least.
MIN_CIRCLE_NODES: int = 5
# A circle is recognised where its radius is at most this many times as long as the line of nodes.
MAX_RADIUS: float = 1e3


def curve_through(points: Array, line: NodeLine, size: float) -> tuple[BoundaryCurve, Array]:
    """The curve through the nodes of ``line``, and their parameters on it, shape ``(k,)``.

    A closed line has one more parameter: that of the first node after one turn. The curve goes through the nodes
    within 1e-9 of the ``size`` of the mesh.
    """
    at = points[line.nodes]
    if not line.is_closed and (found := _straight(at, size)) is not None:
        return found
    if (circle := _circle(at, line.is_closed, size)) is not None:
        return circle
    around = np.concatenate([at, at[:1]]) if line.is_closed else at
    curve = SplineCurve(points=as_points(around), closed=line.is_closed, corners_at=(), where="points")
    return curve, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(around, axis=0).T))])


def _straight(at: Array, size: float) -> tuple[Line, Array] | None:
    """The straight line from the first to the last node, where all lie on it one after the other."""
    line = Line(start=(float(at[0, 0]), float(at[0, 1])), end=(float(at[-1, 0]), float(at[-1, 1])))
    if line.length <= ON_CURVE * size:
        return None
    (along_x, along_y), away = line.direction, at - at[0]
    t = away[:, 0] * along_x + away[:, 1] * along_y
    apart = np.abs(away[:, 1] * along_x - away[:, 0] * along_y)
    if apart.max() > ON_CURVE * size or not (np.diff(t) > 0.0).all():
        return None
    return line, t


def _circle(at: Array, closed: bool, size: float) -> tuple[Circle, Array] | None:
    """The circle through the nodes, where all lie on it one after the other.

    Source: I. Kåsa, A circle fitting procedure and its error analysis, IEEE Trans. Instrum. Meas. 25 (1976), 8-14.
    """
    if len(at) < MIN_CIRCLE_NODES:
        return None
    middle = at.mean(axis=0)
    away = at - middle
    length = float(np.hypot(*np.diff(at, axis=0).T).sum())
    table = np.column_stack([away / length, np.ones(len(at))])
    solved = np.linalg.lstsq(table, (away**2).sum(axis=1) / length**2, rcond=None)[0]
    off = 0.5 * solved[:2]
    squared = float(solved[2] + off @ off)
    if not 0.0 < squared <= MAX_RADIUS**2:
        return None
    center, radius = middle + length * off, length * float(np.sqrt(squared))
    if np.abs(np.hypot(*(at - center).T) - radius).max() > ON_CURVE * size:
        return None
    t = np.unwrap(np.arctan2(at[:, 1] - center[1], at[:, 0] - center[0]))
    if closed:
        turn = 2.0 * np.pi if t[-1] > t[0] else -2.0 * np.pi
        t = np.append(t, t[0] + turn)
    steps = np.diff(t)
    if not ((steps > 0.0).all() or (steps < 0.0).all()):
        return None
    return Circle(center=(float(center[0]), float(center[1])), radius=radius), t
