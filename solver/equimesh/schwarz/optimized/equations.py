"""The equations of a subdomain whose interfaces yield, for Newton's method. Sweeps solve the same equations.

The window's outermost line beyond an interface is held. By the equation across the interface, the last edge inside has
the metric length of those beyond, which :class:`equimesh.schwarz.optimized.sides.YieldingSide` gives.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from equimesh.equations.boundary import Boundary, Side, SideLine, sides
from equimesh.equations.mesh_equations import Cells, Condition, MeshEquations, NodalState, Rows, Triplets
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.optimized.sides import Sides, YieldingSide
from equimesh.schwarz.window import ENDS, SubdomainWindow


def equations(problem: Problem, window: SubdomainWindow, held: Mesh, yielding: Sides) -> MeshEquations:
    """The equations of a window, with its outermost lines beyond interfaces at their positions in ``held``."""
    physical = [side for place, side in sides(problem.boundary).items() if not window.open[place]]
    edges = tuple(
        (float(span.first), float(points - 1 - span.last))
        for span, points in zip(window.part.spans, problem.grid.shape, strict=True)
    )
    conditions: list[Condition] = [*physical]
    for side in yielding.sides:
        beyond = edges[side.axis][side.end]
        conditions.append(YieldingLine(side=side, edges=beyond))
        # The node of an orthogonal side on an interface follows the interior, like all nodes of that side.
        if problem.boundary is not Boundary.ORTHOGONAL:
            ends = [end for end in ENDS if not window.open[1 - side.axis, end]]
            conditions += [YieldingEnd(side=side, edges=beyond, end=end, kind=problem.boundary) for end in ends]
    conditions += [HeldLine(axis=side.axis, end=side.end, held=held) for side in yielding.sides]
    return MeshEquations(problem.metric, window.shape, (problem.grid.d_xi, problem.grid.d_eta), conditions)


@dataclass(frozen=True, kw_only=True)
class HeldLine:
    """The outermost line at one end of a window, at its position in ``held``, a mesh of the window's shape."""

    axis: int
    end: int
    held: Mesh

    def rows(self, window: NodalState) -> Rows:
        """Coordinates minus those that are held."""
        edge = -1 if self.end else 0
        place = edge if self.axis == 0 else (slice(None), edge)
        unknown = np.concatenate([numbers[place] for numbers in window.numbers])
        values = np.concatenate([window.x[place] - self.held.x[place], window.y[place] - self.held.y[place]])
        return Rows(unknown, values, lambda: [(unknown, unknown, np.ones(unknown.size))])


@dataclass(frozen=True, kw_only=True)
class YieldingLine:
    """A yielding interface without its ends, with ``edges`` of the grid beyond: the equation across it.

    The squared metric length of the last edge inside, minus the mean of those beyond as they yield.
    """

    side: YieldingSide
    edges: float

    def rows(self, window: NodalState) -> Rows:
        """One equation for every line that crosses the interface in the interior of the window."""
        turned = window if self.side.axis == 0 else window.turned()
        # Two lines of nodes: the interface and the one inside, in the order of the grid.
        own, first = (1, -3) if self.side.end else (0, 1)
        cells = Cells(_between(turned, first))
        lower, upper = cells.fluxes[0].value[0], cells.fluxes[1].value[0]
        line = -2 if self.side.end else 1
        rest = self.side.rest(window.x, window.y)[1:-1] / turned.d_xi**2
        row = turned.numbers[0][line, 1:-1]
        return Rows(row, upper[:-1] + lower[1:] - rest / self.edges, lambda: self._triplets(turned, cells, own, row))

    def _triplets(self, turned: NodalState, cells: Cells, own: int, row: npt.NDArray[np.int64]) -> Triplets:
        found: Triplets = []
        for edge, inside in ((1, slice(0, -1)), (0, slice(1, None))):
            for corner in range(4):
                for axis in range(2):
                    by = cells.flux_derivatives[edge][corner][axis][0, inside]
                    found.append((row, cells.unknown(corner, axis)[0, inside], by))
        sign = 2.0 if self.side.end else -2.0
        weights = self.side.weights if self.side.axis == 0 else self.side.weights[::-1]
        for axis in range(2):
            by = sign * weights[axis][1:-1] / (self.edges * turned.d_xi**2)
            found.append((row, cells.window.numbers[axis][own, 1:-1], by))
        return found


@dataclass(frozen=True, kw_only=True)
class YieldingEnd:
    """Where a yielding interface meets a physical side, at one ``end`` of it: as :class:`YieldingLine` on the side."""

    side: YieldingSide
    edges: float
    end: int
    kind: Boundary

    def rows(self, window: NodalState) -> Rows:
        """One equation, for the tangential coordinate on the side."""
        axis, corner = self.side.axis, -1 if self.end else 0
        along = Side(axis=1 - axis, end=self.end, kind=self.kind)
        place = slice(-3, -1) if self.side.end else slice(1, 3)
        unknown = along.line(window.numbers[axis])[place]
        edge = SideLine.of(along, window.metric, along.line((window.x, window.y)[axis])[place])
        scale = 1.0 / (window.d_xi, window.d_eta)[axis] ** 2
        rest = self.side.rest(window.x, window.y)[corner] / self.edges
        own = 1 if self.side.end else 0
        row = unknown[own : own + 1]

        def triplets() -> Triplets:
            sign = 2.0 if self.side.end else -2.0
            by_rest = sign * np.atleast_1d(self.side.weights[axis][corner]) / self.edges
            by_first, by_second = edge.flux_derivatives
            return [
                (row, unknown[:1], scale * by_first),
                (row, unknown[1:], scale * by_second),
                (row, row, scale * by_rest),
            ]

        return Rows(row, scale * (edge.fluxes - rest), triplets)


def _between(window: NodalState, first: int) -> NodalState:
    """Two neighbouring lines of a window, from line ``first`` on."""
    rows = slice(first, first + 2)
    numbers = window.numbers[0][rows], window.numbers[1][rows]
    lines = {name: getattr(window, name)[rows] for name in ("x", "y", "u", "u_x", "u_y")}
    return replace(window, numbers=numbers, **lines)
