"""A rectangle with nodes that stay: the description of the blocks between points, curves and layers inside of it.

Lines of the rectangle along which something is fixed are edges of blocks. A curve is a line from side to side, on which
nodes slide. A point is a node on a line of each family, which are straight elsewhere. A layer of cells along a side is
one between two straight lines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from equimesh.blocks.curve_entries import curve_of, entries, mapping, members, named, number, point, whole
from equimesh.blocks.curves import BoundaryCurve, Point
from equimesh.blocks.description import MAX_CELLS
from equimesh.errors import InputError

SIDES = ("left", "right", "bottom", "top")
# The sides at which each family of lines begins and ends: those along x, which have numbers along y, and the others.
ENDS = (("bottom", "top"), ("left", "right"))
# An end of a curve may be so far from a side, as a share of the rectangle, and a point so far from a curve it is on.
NEAR = 1e-6
# The least distance of two lines through points, in cells; points that are nearer lie on one line.
LEAST_GAP = 0.5
# The most layers of a side.
MAX_LAYERS = 200
# Steps from one line to the other until a place is on both, and the distance at which it is, in units of NEAR.
CROSSINGS, CROSSED = 400, 1e-9
# Places of a curve from which Newton's method begins, and its steps.
PLACES, NEWTON_STEPS = 257, 8
REMEDY = "take more cells, or fewer of them"


@dataclass(frozen=True, kw_only=True, eq=False)
class Layers:
    """Cells along a side: the height of the first, and how each is larger than the one before."""

    first: float
    growth: float
    count: int

    @classmethod
    def of(cls, value: object, where: str) -> Layers:
        """The layers of an entry."""
        entry = members(value, where, ("first", "growth", "count"))
        return cls(
            first=number(entry.get("first"), f"{where}.first", positive=True),
            growth=number(entry.get("growth", 1.2), f"{where}.growth", positive=True),
            count=whole(entry.get("count", 5), f"{where}.count", MAX_LAYERS),
        )

    @property
    def heights(self) -> list[float]:
        """The distances of their lines from the side."""
        return np.cumsum(self.first * self.growth ** np.arange(self.count)).tolist()  # type: ignore[no-any-return]


@dataclass(kw_only=True, eq=False)
class Line:
    """A line of one family: its number, and where it runs."""

    index: int
    at: dict[float, float]
    """Its place, by places along it, between which it is straight: of an upright or level line one alone."""
    curve: str | None = None
    is_fixed: bool = False
    is_straight: bool = False
    """Whether it is a side, or a line between layers."""

    def place(self, along: float) -> float:
        """Its place where it crosses the other family at ``along``."""
        known = sorted(self.at.items())
        return float(np.interp(along, [a for a, _ in known], [b for _, b in known]))


@dataclass(kw_only=True, eq=False)
class CurvedLine(Line):
    """A line along a curve, which runs along the axis ``way``; its places are parameters."""

    path: BoundaryCurve
    way: int
    is_fixed: bool = True

    def place(self, along: float) -> float:
        """Its place, by Newton's method from the parameter between those that are known."""
        t = super().place(along)
        for _ in range(NEWTON_STEPS):
            x, y, x_t, y_t = (float(part) for part in self.path.evaluate(np.array(t)))
            t = float(np.clip(t - ((x, y)[self.way] - along) / ((x_t, y_t)[self.way] or math.inf), *self.path.ends))
        x, y, *_ = (float(part) for part in self.path.evaluate(np.array(t)))
        return (x, y)[1 - self.way]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fixed:
    """What is fixed in a rectangle, checked."""

    box: tuple[Point, Point]
    cells: tuple[int, int]
    points: Sequence[Point]
    curves: Mapping[str, BoundaryCurve]
    layers: Mapping[str, Layers]
    lines: tuple[list[Line], list[Line]] = field(default_factory=lambda: ([], []))
    """The lines of constant x, then those of constant y."""

    def place(self) -> None:
        """Find the lines."""
        for axis in (0, 1):
            (low, high), n = self.box[axis], self.cells[axis]
            lines = self.lines[axis]
            for index, at, side, way in ((0, low, ENDS[1 - axis][0], 1), (n, high, ENDS[1 - axis][1], -1)):
                lines.append(Line(index=index, at={0.0: at}, is_straight=True))
                layers = self.layers.get(side)
                for k, height in enumerate(layers.heights if layers else (), start=1):
                    place = at + way * height
                    lines.append(Line(index=index + way * k, at={0.0: place}, is_fixed=True, is_straight=True))
            self._check_layers(axis)
        for name, curve in self.curves.items():
            self._add_curve(name, curve)
        for axis in (0, 1):
            self._add_points(axis)
            self.lines[axis].sort(key=lambda line: line.index)
            self._check_order(axis)

    def _check_layers(self, axis: int) -> None:
        places = sorted((line.index, line.at[0.0]) for line in self.lines[axis])
        for (i, a), (j, b) in pairwise(places):
            if j <= i or b <= a:
                side = next(side for side in ENDS[1 - axis] if side in self.layers)
                raise InputError(
                    f"the layers of {side} do not fit: {self.cells[axis]} cells over"
                    f" {self.box[axis][1] - self.box[axis][0]:g}; take fewer layers, thinner ones, or more cells",
                    field=f"domain.layers.{side}",
                )

    def _index(self, axis: int, at: float) -> float:
        """The number that a line at a place has on the mesh with its layers alone."""
        known = sorted((line.at[0.0], line.index) for line in self.lines[axis] if line.is_straight)
        return float(np.interp(at, [a for a, _ in known], [k for _, k in known]))

    def _add_curve(self, name: str, curve: BoundaryCurve) -> None:
        """The line of a curve, which runs from a side to the opposite one."""
        where = f"domain.curves.{name}"
        t = np.linspace(*curve.ends, PLACES)
        x, y, *_ = curve.evaluate(t)
        size = max(high - low for low, high in self.box)
        for axis, across, along in ((1, y, x), (0, x, y)):
            low, high = self.box[1 - axis]
            turn = slice(None, None, -1 if along[0] > along[-1] else 1)
            if abs(along[turn][0] - low) < NEAR * size and abs(along[turn][-1] - high) < NEAR * size:
                index = round(self._index(axis, float(across.mean())))
                at = dict(zip(along.tolist(), t.tolist(), strict=True))
                line = CurvedLine(index=index, at=at, curve=name, path=curve, way=1 - axis)
                if any(other.index == index for other in self.lines[axis]):
                    raise InputError(f"the curve {name} needs a line that is taken: {REMEDY}", field=where)
                self.lines[axis].append(line)
                return
        raise InputError(
            f"the curve {name} runs from ({x[0]:.6g}, {y[0]:.6g}) to ({x[-1]:.6g}, {y[-1]:.6g}): let it run from the"
            " left side to the right one, or from the bottom to the top; a closed curve needs blocks around it",
            field=where,
        )

    def _add_points(self, axis: int) -> None:
        """Lines through the points; points at nearly the same place of the axis have one line."""
        before: Line | None = None
        for at in sorted(self.points, key=lambda place: place[axis]):
            along = at[1 - axis]
            on = [line for line in self.lines[axis] if line.is_fixed and abs(line.place(along) - at[axis]) < self._near]
            if on:
                continue
            index = self._index(axis, at[axis])
            if before is not None and index - self._index(axis, min(before.at.values())) < LEAST_GAP:
                if along in before.at:
                    raise InputError(f"two points are at ({at[0]:g}, {at[1]:g}): {REMEDY}", field="domain.points")
                before.at[along] = at[axis]
                continue
            taken = {line.index for line in self.lines[axis]}
            free = [k for k in range(1, self.cells[axis]) if k not in taken and self._is_between(axis, k, at)]
            if not free:
                raise InputError(
                    f"no line is left for the point ({at[0]:g}, {at[1]:g}): {REMEDY}", field="domain.points"
                )
            before = Line(index=min(free, key=lambda k: abs(k - index)), at={along: at[axis]})
            self.lines[axis].append(before)

    @property
    def _near(self) -> float:
        return NEAR * max(high - low for low, high in self.box)

    def _is_between(self, axis: int, index: int, at: Point) -> bool:
        """Whether a line with this number lies between the others as the point does."""
        return all((line.index < index) == (line.place(at[1 - axis]) < at[axis]) for line in self.lines[axis])

    def _check_order(self, axis: int) -> None:
        """Refuse lines that meet."""
        places = sorted({along for line in self.lines[axis] for along in line.at})
        for one, other in pairwise(self.lines[axis]):
            meeting = [along for along in places if other.place(along) - one.place(along) <= self._near]
            if meeting:
                names = " and ".join(line.curve or "a straight line" for line in (one, other))
                raise InputError(f"{names} meet near {'yx'[axis]} = {meeting[0]:.6g}: {REMEDY}", field="domain")

    def crossing(self, column: Line, row: Line) -> Point:
        """Where two lines cross; a point that is fixed is there exactly."""
        x = column.place(float(np.mean(self.box[1])))
        for _ in range(CROSSINGS):
            y, before = row.place(x), x
            x = column.place(y)
            if abs(x - before) < CROSSED * self._near:
                break
        near = [at for at in self.points if max(abs(at[0] - x), abs(at[1] - y)) < self._near]
        return near[0] if near else (x, y)

    def document(self) -> dict[str, Any]:
        """The description of the blocks between the lines."""
        columns, rows = self.lines
        vertices = {
            (i, j): self.crossing(column, row) for i, column in enumerate(columns) for j, row in enumerate(rows)
        }
        name = {place: f"{columns[place[0]].index},{rows[place[1]].index}" for place in vertices}
        blocks = [
            {
                "name": f"{name[i, j]}".replace(",", "_"),
                "corners": [name[place] for place in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))],
                "cells": [columns[i + 1].index - columns[i].index, rows[j + 1].index - rows[j].index],
            }
            for i, j in np.ndindex(len(columns) - 1, len(rows) - 1)
        ]
        edges, fixed = [], []
        sides: dict[str, list[list[str]]] = {}
        for axis, lines in enumerate(self.lines):
            for k, line in enumerate(lines):
                steps = [
                    ((k, n), (k, n + 1)) if axis == 0 else ((n, k), (n + 1, k))
                    for n in range(len(self.lines[1 - axis]) - 1)
                ]
                ends = [[name[one], name[other]] for one, other in steps]
                if line.curve is not None:
                    edges += [{"from": one, "to": other, "on": line.curve} for one, other in ends]
                if line.is_fixed:
                    fixed += ends
                if k in (0, len(lines) - 1):
                    sides[ENDS[1 - axis][k > 0]] = ends
        return {
            "vertices": {name[place]: list(at) for place, at in vertices.items()},
            "edges": edges,
            "blocks": blocks,
            "sides": {side: sides[side] for side in SIDES},
            "corners": [name[place] for place, at in vertices.items() if at in self.points],
            "fixed": fixed,
        }


def fixed_rectangle(
    x: object = (0.0, 1.0),
    y: object = (0.0, 1.0),
    cells: object = (32, 32),
    points: object = (),
    curves: object = None,
    layers: object = None,
) -> dict[str, Any]:
    """The description of blocks; the arguments are those of :meth:`equimesh.Blocks.rectangle`."""
    box = point(x, "domain.x"), point(y, "domain.y")
    for name, (low, high) in zip("xy", box, strict=True):
        if not low < high:
            raise InputError(f"{name} = [{low:g}, {high:g}]: give two numbers that increase", field=f"domain.{name}")
    along_x, along_y = (
        whole(n, f"domain.cells[{k}]", MAX_CELLS) for k, n in enumerate(entries(cells, "domain.cells", count=2))
    )
    places = [point(at, f"domain.points[{k}]") for k, at in enumerate(entries(points, "domain.points"))]
    for k, at in enumerate(places):
        if not all(low < q < high for q, (low, high) in zip(at, box, strict=True)):
            raise InputError(f"({at[0]:g}, {at[1]:g}) is not inside the rectangle", field=f"domain.points[{k}]")
    given = {} if curves is None else named(curves, "domain.curves", "a curve")
    of = members({} if layers is None else layers, "domain.layers", SIDES)
    found = Fixed(
        box=box,
        cells=(along_x, along_y),
        points=places,
        curves={name: curve_of(entry, f"domain.curves.{name}") for name, entry in given.items()},
        layers={
            side: Layers.of(entry, f"domain.layers.{side}") for side, entry in mapping(of, "domain.layers").items()
        },
    )
    found.place()
    return {"curves": dict(given), **found.document()}
