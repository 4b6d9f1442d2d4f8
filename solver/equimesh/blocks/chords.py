"""Edges of cells that join two points of a boundary curve: the area between them and the curve."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from equimesh.blocks.curves import BoundaryCurve, Line
from equimesh.domains.cut_off import PLACES, area_between
from equimesh.numerics.types import Array, BoolArray, IntArray

MAX_DISTANCE_SHARE = 1e-6
"""The largest distance of a fixed node from a curve that it ends, as a share of the size of the curve."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chords:
    """Edges between two points of one ``curve``: the two ``nodes`` of each, shape ``(edges, 2)``."""

    curve: BoundaryCurve
    nodes: IntArray
    fixed: Array
    """The parameters of nodes that are fixed, else NaN, shape ``(edges, 2)``."""
    turns: Array
    """What the parameter jumps by from the first to the second node, shape ``(edges,)``: turns of a closed curve."""

    @classmethod
    def of(
        cls, curve: BoundaryCurve, edges: IntArray, slides: BoolArray, points: Array, parameters: Array
    ) -> Chords | None:
        """The chords of the ``edges`` with a node that ``slides`` on the curve; ``None`` for a line, or without any.

        ``slides`` and ``parameters`` have the shape ``(nodes,)``, ``points`` the shape ``(2, nodes)``. An edge whose
        other node is not on the curve is left out.
        """
        nodes = edges[slides[edges].any(axis=1)]
        if isinstance(curve, Line) or not nodes.size:
            return None
        (first, last), fixed = curve.ends, np.full(nodes.shape, math.nan)
        x, y, _, _ = curve.evaluate(np.linspace(first, last, 9))
        size, is_fixed = float(np.ptp(x) + np.ptp(y)), ~slides[nodes]
        at = points[:, nodes[is_fixed]]
        fixed[is_fixed] = curve.nearest(*at)
        there_x, there_y, _, _ = curve.evaluate(fixed[is_fixed])
        is_near = np.ones(nodes.shape, dtype=bool)
        is_near[is_fixed] = np.hypot(there_x - at[0], there_y - at[1]) <= MAX_DISTANCE_SHARE * size
        meets = math.hypot(x[-1] - x[0], y[-1] - y[0]) <= MAX_DISTANCE_SHARE * size
        begins, ends = np.where(is_fixed, fixed, parameters[nodes]).T
        turns = (last - first) * np.round((ends - begins) / (last - first)) if meets else np.zeros(len(nodes))
        kept = is_near.all(axis=1)
        return cls(curve=curve, nodes=nodes[kept], fixed=fixed[kept], turns=turns[kept])

    def cut_off(self, parameters: Array) -> float:
        """The area between the curve and the edges, for ``parameters`` of all nodes, shape ``(nodes,)``."""
        begins, ends = np.where(np.isnan(self.fixed), parameters[self.nodes], self.fixed).T
        t = begins[:, None] + np.multiply.outer(ends - self.turns - begins, PLACES)
        x, y, _, _ = self.curve.evaluate(t)
        return area_between(x, y)
