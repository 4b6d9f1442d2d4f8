"""Charts: what the unknowns of a least-error mesh are, where its nodes lie for them, and the derivatives by them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from equimesh.blocks.curves import BoundaryCurve, Chords, Line, Pieces
from equimesh.domains.domain import Domain, Rectangle, cut_off
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair

FREE = -1
"""The number of the curve of a node that is on none. That of a fixed node is less."""
KNOWN_MESHES = 4
"""Meshes whose physical nodes are kept: in a step the one before and after it, the first and the initial one."""


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


@dataclass(frozen=True, kw_only=True)
class Slides:
    """The ``nodes`` on a curve, whose parameter times ``speed`` is their unknown, and edges between them."""

    curve: BoundaryCurve | Lines
    nodes: IntArray
    speed: float
    chords: Chords | None = None


class Placed(NamedTuple):
    """The nodes of a mesh, the directions of their curves, each ``x_t, y_t``, and what lies between these and edges."""

    at: Array
    slopes: list[Pair]
    pieces: list[Pieces]


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
        self._curves: list[Slides] = []
        self._has_chords = False
        lines = []
        for number, curve in enumerate(curves):
            nodes = np.flatnonzero(on_curve == number)
            if nodes.size and isinstance(curve, Line):
                lines.append((curve, nodes))
            elif nodes.size:
                _, _, x_t, y_t = curve.evaluate(parameters[nodes])
                self._curves.append(Slides(curve=curve, nodes=nodes, speed=float(np.hypot(x_t, y_t).mean())))
        if lines:
            nodes = np.concatenate([nodes for _, nodes in lines])
            self._curves.append(Slides(curve=Lines.of(lines), nodes=nodes, speed=1.0))
        self._known: deque[tuple[Array, Placed]] = deque(maxlen=KNOWN_MESHES)
        self.free = np.ones((2, on_curve.size))
        self.free[1, on_curve >= 0] = 0.0
        self.free[:, on_curve < FREE] = 0.0

    def on(self, nodes: IntArray) -> CurveChart:
        """The chart of these nodes alone, for arrays of their unknowns."""
        chart = copy(self)
        chart.free = self.free[:, nodes]
        chart._curves, chart._has_chords = [], False
        chart._known = deque(maxlen=KNOWN_MESHES)
        if not (chart.free[0] > chart.free[1]).any():  # none of them slides
            return chart
        place = np.full(self.free.shape[1], -1)
        place[nodes] = np.arange(nodes.size)
        for one in self._curves:
            there = place[one.nodes]
            if (there >= 0).any():
                curve = one.curve.on(there >= 0) if isinstance(one.curve, Lines) else one.curve
                chart._curves.append(Slides(curve=curve, nodes=there[there >= 0], speed=one.speed))
        return chart

    def unknowns(self, points: Array, parameters: Array) -> Array:
        """The unknowns, shape ``(2, nodes)``, of nodes at ``points``, shape ``(2, nodes)``, with these parameters."""
        mesh = points.copy()
        for one in self._curves:
            mesh[0, one.nodes], mesh[1, one.nodes] = parameters[one.nodes] * one.speed, 0.0
        return mesh

    def parameters(self, mesh: Array) -> Array:
        """The parameters of the nodes on their curves, 0 for other nodes, shape ``(nodes,)``."""
        parameters = np.zeros(mesh.shape[1])
        for one in self._curves:
            parameters[one.nodes] = mesh[0, one.nodes] / one.speed
        return parameters

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes. Those of the last meshes are kept: neither they nor the meshes may be changed."""
        x, y = self._placed(mesh).at
        return x, y

    def at(self, mesh: Array) -> Array:
        """:meth:`nodes` as one array, shape ``(2, nodes)``."""
        return self._placed(mesh).at

    def _placed(self, mesh: Array) -> Placed:
        """What is known of a mesh: each curve is evaluated once, at its nodes and between them."""
        for k, (known, found) in enumerate(self._known):
            if known is mesh:
                del self._known[k]  # to be the first again
                self._known.appendleft((mesh, found))
                return found
        placed = Placed(mesh.copy(), [], [])
        for one in self._curves:
            t, count = mesh[0, one.nodes] / one.speed, one.nodes.size
            if one.chords is not None:
                lengths, places = one.chords.places(mesh[0], one.speed)
                t = np.concatenate([t, places.reshape(-1)])
            at = one.curve.evaluate(t)
            if one.chords is not None:
                placed.pieces.append(Pieces(one.chords, lengths, *(part[count:].reshape(places.shape) for part in at)))
            placed.at[0, one.nodes], placed.at[1, one.nodes], x_t, y_t = (part[:count] for part in at)
            placed.slopes.append((x_t, y_t))
        self._known.appendleft((mesh, placed))
        return placed

    def cut_off(self, mesh: Array, sides: IntArray) -> float:
        """The area between the curves and edges of cells, always the same edges; 0 where all curves are lines."""
        if not self._has_chords:
            self._curves = [self._with_chords(one, mesh, sides) for one in self._curves]
            self._has_chords = True
            self._known.clear()
        return math.fsum(pieces.area for pieces in self._placed(mesh).pieces)

    def _with_chords(self, one: Slides, mesh: Array, sides: IntArray) -> Slides:
        if isinstance(one.curve, Lines):
            return one
        slides = np.zeros(mesh.shape[1], dtype=bool)
        slides[one.nodes] = True
        return replace(one, chords=Chords.of(one.curve, sides, slides, mesh, mesh[0] / one.speed))

    def add_cut_off(self, mesh: Array, weight: float, gradient: Array, blocks: Array) -> None:
        """Add ``weight`` times the derivatives of :meth:`cut_off` by the parameters, which was called before."""
        curves = [one for one in self._curves if one.chords is not None]
        for one, pieces in zip(curves, self._placed(mesh).pieces, strict=True):
            slopes, bends = pieces.derivatives(mesh.shape[1])
            gradient[0, one.nodes] += weight / one.speed * slopes[one.nodes]
            blocks[0, one.nodes] += weight / one.speed**2 * bends[one.nodes]

    def pulled(self, mesh: Array, moves: Array) -> Array:
        """The moves of the unknowns at ``mesh`` for small ``moves`` of the nodes, both of shape ``(2, nodes)``.

        On a curve those along it; 0 where a node is fixed.
        """
        out = moves * self.free
        for one in self._curves:
            nodes, speed = one.nodes, one.speed
            _, _, x_t, y_t = one.curve.evaluate(mesh[0, nodes] / speed)
            out[0, nodes] = speed * (moves[0, nodes] * x_t + moves[1, nodes] * y_t) / (x_t * x_t + y_t * y_t)
        return out

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements over the square root of the area."""
        return (self.at(mesh) - self.at(start)) / self.length

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """Derivatives by the unknowns, see :meth:`Chart.derivatives`; on a curve along its tangent."""
        collected[:2] += bends / self.length
        collected[2::2] += stiffness / self.area
        gradient, blocks = collected[:2], collected[2:]
        for one, slopes in zip(self._curves, self._placed(mesh).slopes, strict=True):
            nodes, (x_t, y_t) = one.nodes, (part / one.speed for part in slopes)
            (g, h), (a, b, d) = gradient[:, nodes], blocks[:, nodes]
            gradient[0, nodes], gradient[1, nodes] = g * x_t + h * y_t, 0.0
            blocks[0, nodes] = a * x_t * x_t + 2.0 * b * x_t * y_t + d * y_t * y_t
            blocks[1, nodes], blocks[2, nodes] = 0.0, 1.0
        return gradient, blocks
