"""Charts: what the unknowns of a least-error mesh are, where its nodes lie for them, and the derivatives by them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from equimesh.blocks.curves import BoundaryCurve, Chords, Line
from equimesh.domains.domain import Domain, Rectangle, cut_off
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair

FREE = -1
"""The number of the curve of a node that is on none. That of a fixed node is less."""
KNOWN_MESHES = 3
"""Meshes whose physical nodes are kept: each is asked for several times in a step, and that of the start in all."""


class Chart(Protocol):
    """The way from the unknowns of a mesh, an array of shape ``(2, nodes)``, to its physical nodes."""

    @property
    def area(self) -> float:
        """The area of the domain."""
        ...

    def on(self, nodes: IntArray) -> Chart:
        """The chart of these nodes alone, for arrays of their unknowns; all else is that of the whole domain."""
        ...

    @property
    def length(self) -> float:
        """The size of the domain in the units of the unknowns."""
        ...

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes, contiguous."""
        ...

    def cut_off(self, mesh: Array, sides: IntArray) -> float:
        """The area between the curved sides of the domain and the edges ``sides`` of cells, shape ``(edges, 2)``."""
        ...

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements from ``start`` whose second differences are kept small, dimensionless, ``(2, nodes)``."""
        ...

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """The derivatives by the unknowns, shape ``(2, nodes)``, and their second ones, ``(3, nodes)``.

        ``collected`` are those by x and y with ``(xx, xy, yy)``, shape ``(5, nodes)``. ``bends`` are the derivatives of
        the smoothness by the ``moves``, shape ``(2, nodes)``, and ``stiffness`` its second ones, shape ``(nodes,)``.
        """
        ...


class DomainChart:
    """Coordinates of the reference square, which the map of a ``domain`` takes to the nodes."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        self.is_identity = isinstance(domain, Rectangle) and domain.is_unit_square
        """Whether the nodes are the coordinates themselves."""

    @property
    def area(self) -> float:
        """The area of the domain."""
        return self.domain.area

    def on(self, nodes: IntArray) -> DomainChart:  # noqa: ARG002
        """The chart itself: it is the same for all nodes."""
        return self

    @property
    def length(self) -> float:
        """The side of the reference square."""
        return 1.0

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes."""
        if self.is_identity:
            return mesh[0], mesh[1]
        x, y = self.domain.map(mesh[0], mesh[1])
        return np.ascontiguousarray(x), np.ascontiguousarray(y)

    def cut_off(self, mesh: Array, sides: IntArray) -> float:
        """The area between the sides of the domain and edges of cells; 0 for a rectangle."""
        if isinstance(self.domain, Rectangle):
            return 0.0
        return cut_off(self.domain, mesh[:, sides[:, 0]], mesh[:, sides[:, 1]])

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements on the reference square."""
        return mesh - start

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """Derivatives by the unknowns, see :meth:`Chart.derivatives`: the chain rule through the map of the domain."""
        gradient, blocks = self._pulled_back(mesh, collected)
        gradient += bends
        blocks[::2] += stiffness
        return gradient, blocks

    def _pulled_back(self, mesh: Array, collected: Array) -> Pair:
        if self.is_identity:
            return collected[:2], collected[2:]
        (g, h), (a, b, d) = collected[:2], collected[2:]
        x_s, x_t, y_s, y_t = self.domain.jacobian(mesh[0], mesh[1])
        gradient = np.stack([g * x_s + h * y_s, g * x_t + h * y_t])
        blocks = np.stack(
            [
                a * x_s * x_s + 2.0 * b * x_s * y_s + d * y_s * y_s,
                a * x_s * x_t + b * (x_s * y_t + x_t * y_s) + d * y_s * y_t,
                a * x_t * x_t + 2.0 * b * x_t * y_t + d * y_t * y_t,
            ]
        )
        return gradient, blocks


class Slope(Protocol):
    """A curve that can be evaluated."""

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` at values of t."""
        ...


@dataclass(frozen=True)
class Lines:
    """Straight lines, one for each of some nodes: where it begins, and its unit vector, all of shape ``(nodes,)``."""

    x: Array
    y: Array
    along_x: Array
    along_y: Array

    @classmethod
    def of(cls, lines: Sequence[tuple[Line, IntArray]]) -> Lines:
        """One line for each node: the nodes of the first line come first."""
        rows = np.array([(*line.start, *line.direction) for line, _ in lines])
        return cls(*np.repeat(rows, [nodes.size for _, nodes in lines], axis=0).T.copy())

    def on(self, kept: BoolArray) -> Lines:
        """The lines of the nodes where ``kept`` is true."""
        return Lines(self.x[kept], self.y[kept], self.along_x[kept], self.along_y[kept])

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` at the distance t of every node from the start of its line."""
        return self.x + self.along_x * t, self.y + self.along_y * t, self.along_x, self.along_y


class CurveChart:
    """Coordinates of free nodes, and parameters of nodes on curves: these slide along their curve exactly.

    The unknowns of a free node are x and y. The first unknown of a node on a curve is the parameter times the mean
    speed of the curve, a length; the second is 0. Those of a fixed node are x and y, which do not change.
    """

    def __init__(self, curves: Sequence[BoundaryCurve], on_curve: IntArray, parameters: Array, area: float) -> None:
        """``on_curve`` are the numbers of the nodes' ``curves``, ``parameters`` their first parameters there.

        ``on_curve`` is -1 for a free node, -2 for a fixed one. ``area`` is that of the domain.
        """
        self.area, self.length = area, math.sqrt(area)
        self._bounds, self._on_curve = tuple(curves), on_curve
        self._chords: list[Chords] | None = None
        self._curves: list[tuple[Slope, IntArray, float]] = []
        lines = []
        for number, curve in enumerate(curves):
            nodes = np.flatnonzero(on_curve == number)
            if nodes.size and isinstance(curve, Line):
                lines.append((curve, nodes))
            elif nodes.size:
                _, _, x_t, y_t = curve.evaluate(parameters[nodes])
                self._curves.append((curve, nodes, float(np.hypot(x_t, y_t).mean())))
        if lines:
            together = Lines.of(lines)
            self._curves.append((together, np.concatenate([nodes for _, nodes in lines]), 1.0))
        self._known: deque[tuple[Array, Pair]] = deque(maxlen=KNOWN_MESHES)
        self.free = np.ones((2, on_curve.size))
        self.free[1, on_curve >= 0] = 0.0
        self.free[:, on_curve < FREE] = 0.0

    def on(self, nodes: IntArray) -> CurveChart:
        """The chart of these nodes alone, for arrays of their unknowns."""
        place = np.full(self.free.shape[1], -1)
        place[nodes] = np.arange(nodes.size)
        chart = copy(self)
        chart.free = self.free[:, nodes]
        chart._on_curve, chart._chords = self._on_curve[nodes], None
        chart._curves = []
        for curve, on_curve, speed in self._curves:
            there = place[on_curve]
            if (there >= 0).any():
                part = curve.on(there >= 0) if isinstance(curve, Lines) else curve
                chart._curves.append((part, there[there >= 0], speed))
        chart._known = deque(maxlen=KNOWN_MESHES)
        return chart

    def unknowns(self, points: Array, parameters: Array) -> Array:
        """The unknowns, shape ``(2, nodes)``, of nodes at ``points``, shape ``(2, nodes)``, with these parameters."""
        mesh = points.copy()
        for _, nodes, speed in self._curves:
            mesh[0, nodes], mesh[1, nodes] = parameters[nodes] * speed, 0.0
        return mesh

    def parameters(self, mesh: Array) -> Array:
        """The parameters of the nodes on their curves, 0 for other nodes, shape ``(nodes,)``."""
        parameters = np.zeros(mesh.shape[1])
        for _, nodes, speed in self._curves:
            parameters[nodes] = mesh[0, nodes] / speed
        return parameters

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes. Those of the last meshes are kept: neither they nor the meshes may be changed."""
        for k, (known, found) in enumerate(self._known):
            if known is mesh:
                del self._known[k]  # to be the first again
                self._known.appendleft((mesh, found))
                return found
        x, y = mesh[0].copy(), mesh[1].copy()
        for curve, nodes, speed in self._curves:
            x[nodes], y[nodes], _, _ = curve.evaluate(mesh[0, nodes] / speed)
        at = x, y
        self._known.appendleft((mesh, at))
        return at

    def cut_off(self, mesh: Array, sides: IntArray) -> float:
        """The area between the curves and edges of cells, always the same edges; 0 where all curves are lines."""
        if self._chords is not None and not self._chords:
            return 0.0
        parameters = self.parameters(mesh)
        if self._chords is None:
            slides = ((curve, self._on_curve == number) for number, curve in enumerate(self._bounds))
            found = [Chords.of(curve, sides, on, mesh, parameters) for curve, on in slides]
            self._chords = [chords for chords in found if chords is not None]
        return math.fsum(chords.cut_off(parameters) for chords in self._chords)

    def add_cut_off(self, mesh: Array, weight: float, gradient: Array, blocks: Array) -> None:
        """Add ``weight`` times the derivatives of :meth:`cut_off`, which was called before, by the parameters."""
        parameters = self.parameters(mesh)
        for chords in self._chords or ():
            slopes, bends = chords.derivatives(parameters)
            for _, nodes, speed in self._curves:
                gradient[0, nodes] += weight / speed * slopes[nodes]
                blocks[0, nodes] += weight / speed**2 * bends[nodes]

    def pulled(self, mesh: Array, moves: Array) -> Array:
        """The moves of the unknowns at ``mesh`` for small ``moves`` of the nodes, both of shape ``(2, nodes)``.

        On a curve those along it; 0 where a node is fixed.
        """
        out = moves * self.free
        for curve, nodes, speed in self._curves:
            _, _, x_t, y_t = curve.evaluate(mesh[0, nodes] / speed)
            out[0, nodes] = speed * (moves[0, nodes] * x_t + moves[1, nodes] * y_t) / (x_t * x_t + y_t * y_t)
        return out

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements over the square root of the area."""
        here, there = self.nodes(mesh), self.nodes(start)
        return np.stack([(one - other) / self.length for one, other in zip(here, there, strict=True)])

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """Derivatives by the unknowns, see :meth:`Chart.derivatives`; on a curve along its tangent."""
        collected[:2] += bends / self.length
        collected[2::2] += stiffness / self.area
        gradient, blocks = collected[:2], collected[2:]
        for curve, nodes, speed in self._curves:
            _, _, x_t, y_t = curve.evaluate(mesh[0, nodes] / speed)
            x_t, y_t = x_t / speed, y_t / speed
            (g, h), (a, b, d) = gradient[:, nodes], blocks[:, nodes]
            gradient[0, nodes], gradient[1, nodes] = g * x_t + h * y_t, 0.0
            blocks[0, nodes] = a * x_t * x_t + 2.0 * b * x_t * y_t + d * y_t * y_t
            blocks[1, nodes], blocks[2, nodes] = 0.0, 1.0
        return gradient, blocks
