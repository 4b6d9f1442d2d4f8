"""The one grid that conforming blocks form, if they do: its domain, its size, and the lines at which blocks meet.

Equidistribution needs lines from side to side. Blocks that lie in rows and columns have such lines, through all blocks
of a row or a column. Their grid is then a problem as any other, with the blocks as the subdomains of a Schwarz
iteration.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import BoundaryCurve
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, TOP
from equimesh.blocks.sliding import FREE
from equimesh.domains.curve import Curve
from equimesh.domains.quadrilateral import Quadrilateral
from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.types import Array, IntArray

# The sides of a block, counter-clockwise, and the step to the place of the neighbour across each.
AROUND = (BOTTOM, RIGHT, TOP, LEFT)
STEPS = ((0, -1), (1, 0), (0, 1), (-1, 0))
# Pieces of a curve whose chords are added up for its length.
CHORDS = 64
# The largest gap between two edges that go on along one curve, as a share of their parameters.
SAME_PARAMETER = 1e-9
REMEDY = (
    "such blocks form no grid with four sides; take LeastError(u=...), which measures the error on"
    " cells and needs no lines"
)
"""The remedy where blocks are no grid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockGrid:
    """Blocks in rows and columns as one grid. Build it by :meth:`of`.

    - ``blocks``: the domain in blocks.
    - ``domain``: the same domain with four sides, each along the curves of its blocks.
    - ``grid``: all cells of the blocks; the first block is not turned.
    - ``cuts``: the grid lines along xi and along eta at which blocks meet: the ``subdomains`` of a
      :class:`~equimesh.schwarz.settings.Schwarz` iteration with a subdomain for every block.
    - ``nodes``: the numbers that the nodes of the grid have in the mesh of the blocks, shape ``(n_xi, n_eta)``.
    """

    blocks: Blocks
    domain: Quadrilateral
    grid: Grid
    cuts: tuple[tuple[int, ...], tuple[int, ...]]
    nodes: IntArray

    @classmethod
    def of(cls, blocks: Blocks) -> BlockGrid:
        """The grid of these blocks.

        Raises :class:`~equimesh.errors.InputError` where they are not the rows and columns of one grid: around a
        singular node, at a re-entrant corner, and where lines are closed; the message names the block. So it does where
        nodes inside stay, since the lines of a grid move.
        """
        _refuse_fixed(blocks)
        table, turns = _placed(blocks)
        turned = [np.rot90(nodes, turn) for nodes, turn in zip(blocks.mesh.blocks, turns, strict=True)]
        columns = [np.concatenate([turned[k][:, (row > 0) :] for row, k in enumerate(column)], 1) for column in table]
        nodes = np.concatenate([part[(k > 0) :] for k, part in enumerate(columns)])
        cuts = (
            tuple(int(n) for n in np.cumsum([turned[column[0]].shape[0] - 1 for column in table])[:-1]),
            tuple(int(n) for n in np.cumsum([turned[k].shape[1] - 1 for k in table[0]])[:-1]),
        )
        bottom, right, top, left = (_side(blocks, line) for line in (nodes[:, 0], nodes[-1], nodes[:, -1], nodes[0]))
        return cls(
            blocks=blocks,
            domain=Quadrilateral(bottom=bottom, right=right, top=top, left=left),
            grid=Grid(n_xi=nodes.shape[0], n_eta=nodes.shape[1]),
            cuts=cuts,
            nodes=nodes,
        )

    def quad_mesh(self, mesh: Mesh) -> Mesh:
        """A mesh of the grid, such as that of a solution, as one of the blocks, with their sides and numbers."""
        if mesh.grid != self.grid:
            raise InputError(f"the mesh has {mesh.grid} points, the blocks {self.grid}", field="mesh")
        points = np.empty_like(self.blocks.mesh.points)
        points[self.nodes] = np.stack([mesh.x, mesh.y], axis=-1)
        return self.blocks.mesh.moved(points)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Pieces of curves one after the other, as a :class:`~equimesh.domains.curve.Path`.

    ``breaks`` are the values of t at their ends, ``curves`` and ``spans`` the curve of each piece and its parameters.
    """

    breaks: Array
    curves: tuple[BoundaryCurve, ...]
    spans: tuple[tuple[float, float], ...]

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``; beyond [0, 1] the first and the last curve are continued."""
        flat = t.ravel()
        piece = np.clip(np.searchsorted(self.breaks, flat, side="right") - 1, 0, len(self.curves) - 1)
        out = np.empty((4, flat.size))
        for k, (curve, (first, last)) in enumerate(zip(self.curves, self.spans, strict=True)):
            here = piece == k
            speed = (last - first) / (self.breaks[k + 1] - self.breaks[k])
            share = (flat[here] - self.breaks[k]) / (self.breaks[k + 1] - self.breaks[k])
            x, y, x_t, y_t = curve.evaluate(first * (1.0 - share) + last * share)
            out[:, here] = x, y, x_t * speed, y_t * speed
        x, y, x_t, y_t = (part.reshape(t.shape) for part in out)
        return x, y, x_t, y_t


def _placed(blocks: Blocks) -> tuple[list[list[int]], list[int]]:
    """The blocks by column and row, and by how many quarters each is turned counter-clockwise."""
    neighbours, names = blocks.layout.neighbours, blocks.mesh.block_names
    at: dict[int, tuple[int, int, int]] = {0: (0, 0, 0)}
    found = deque([0])
    while found:
        here = found.popleft()
        column, row, turn = at[here]
        for local, side in enumerate(AROUND):
            other, across, _ = (int(n) for n in neighbours[here, side])
            if other < 0:
                continue
            way = (local + turn) % 4
            place = column + STEPS[way][0], row + STEPS[way][1], (way + 2 - AROUND.index(across)) % 4
            if other not in at:
                at[other] = place
                found.append(other)
            elif at[other] != place:
                is_closed = at[other][2] == place[2]
                why = (
                    f"lines are closed from block {names[here]} to block {names[other]}"
                    if is_closed
                    else f"the blocks {names[here]} and {names[other]} meet at a singular node, one of them turned"
                )
                raise InputError(f"{why}: {REMEDY}", field="domain.blocks")
    by_place = {(column, row): k for k, (column, row, _) in at.items()}
    columns, rows = (sorted({place[axis] for place in by_place}) for axis in (0, 1))
    missing = [(column, row) for column in columns for row in rows if (column, row) not in by_place]
    if missing or len(by_place) != len(names):
        column, row = missing[0] if missing else (0, 0)
        around = ((column + i, row + j) for i, j in STEPS)
        near = next((by_place[place] for place in around if place in by_place), 0)
        raise InputError(
            f"the blocks do not fill the rows and columns of one grid: there is a gap next to block {names[near]},"
            f" which has a re-entrant corner; {REMEDY}",
            field="domain.blocks",
        )
    return [[by_place[column, row] for row in rows] for column in columns], [at[k][2] for k in range(len(names))]


def _refuse_fixed(blocks: Blocks) -> None:
    """Refuse blocks with nodes inside that stay."""
    sides = np.unique(np.concatenate([edge.nodes for edge in blocks.boundary_edges]))
    inside = np.setdiff1d(np.flatnonzero(blocks.node_curve != FREE), sides)
    if inside.size:
        x, y = blocks.mesh.points[inside[0]]
        message = f"the node ({x:.6g}, {y:.6g}) inside stays on its line, and the lines of a grid move: take LeastError"
        raise InputError(message, field="domain.fixed")


def _side(blocks: Blocks, line: IntArray) -> Curve:
    """The curve along the nodes of one side, through all edges of blocks on it."""
    place = np.full(blocks.points, -1)
    place[line] = np.arange(line.size)
    pieces: list[tuple[int, int, float, float]] = []
    for edge in blocks.boundary_edges:
        where = place[edge.nodes]
        if (where >= 0).all() and abs(int(where[-1]) - int(where[0])) == len(where) - 1:
            t = edge.parameters if where[0] < where[-1] else edge.parameters[::-1]
            pieces.append((int(where.min()), edge.curve, float(t[0]), float(t[-1])))
    joined: list[tuple[int, float, float]] = []
    for _, curve, first, last in sorted(pieces):
        before = joined[-1] if joined else None
        if before is not None and before[0] == curve and abs(before[2] - first) <= SAME_PARAMETER * abs(last - first):
            joined[-1] = curve, before[1], last
        else:
            joined.append((curve, first, last))
    lengths = [_length(blocks.curves[curve], first, last) for curve, first, last in joined]
    breaks = np.concatenate([[0.0], np.cumsum(lengths) / sum(lengths)])
    breaks[-1] = 1.0
    curves, spans = tuple(blocks.curves[curve] for curve, _, _ in joined), tuple(piece[1:] for piece in joined)
    return Curve(path=Pieces(breaks=breaks, curves=curves, spans=spans))


def _length(curve: BoundaryCurve, first: float, last: float) -> float:
    """The length of a piece of a curve, by its chords."""
    x, y, *_ = curve.evaluate(np.linspace(first, last, CHORDS + 1))
    return float(sum(np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(zip(x, y, strict=True))))
