"""A rectangle with nodes that stay: the description of the blocks between points, curves and layers inside of it.

Lines of the rectangle along which something is fixed are edges of blocks. A curve is a line from side to side, on which
nodes slide. A layer of cells along a side is one between two straight lines. A point is a node on a line of each
family, which keeps its share of the way between the lines that are fixed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.blocks.curve_entries import curve_of, entries, mapping, members, named, number, point, whole, with_points
from equimesh.blocks.curves import BoundaryCurve, Point
from equimesh.blocks.description import MAX_BLOCKS, MAX_CELLS
from equimesh.errors import InputError
from equimesh.numerics.types import Array

SIDES = ("left", "right", "bottom", "top")
# The sides at which each family of lines begins and ends: those along x, which have numbers along y, and the others.
ENDS = (("bottom", "top"), ("left", "right"))
# An end of a curve may be so far from a side, as a share of the rectangle, and a point so far from a curve it is on.
NEAR = 1e-6
# The least distance of two lines through points, in cells; points that are nearer lie on one line.
LEAST_GAP = 0.5
# The most layers of a side, and points.
MAX_LAYERS, MAX_POINTS = 200, 1000
# Steps from one line to the other until a place is on both, and the distance at which it is, in units of NEAR.
CROSSINGS, CROSSED = 400, 1e-9
# Places of a curve from which Newton's method begins, and its steps.
PLACES, NEWTON_STEPS = 257, 8
WANTED_POINTS = "a list of places (x, y) at which nodes stay; cells tells how many cells there are"
WANTED_CELLS = "two numbers, those along x and along y, such as (32, 32)"
REMEDY = "take more cells, or fewer of them"
# Examples of what is given by name.
LAYER = ", such as {'first': 0.001, 'growth': 1.2, 'count': 5}"
LAYERS = ", such as {'bottom': {'first': 0.001}}"
CURVES = ", such as {'interface': {'x': 't', 'y': '0.5'}}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Layers:
    """Cells along a side: the height of the first, and how each is larger than the one before."""

    first: float
    growth: float
    count: int

    @classmethod
    def of(cls, value: object, where: str) -> Layers:
        """The layers of an entry."""
        entry = members(value, where, ("first", "growth", "count"), LAYER)
        return cls(
            first=number(entry.get("first"), f"{where}.first", positive=True),
            growth=number(entry.get("growth", 1.2), f"{where}.growth", positive=True),
            count=whole(entry.get("count", 5), f"{where}.count", MAX_LAYERS),
        )

    @property
    def heights(self) -> list[float]:
        """The distances of their lines from the side."""
        return np.cumsum(self.first * self.growth ** np.arange(self.count)).tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A line of one family: its number, and its place, the same all along. A side, or a line between layers."""

    index: int
    at: float = 0.0
    curve: str | None = None
    is_fixed: bool = False

    def place(self, along: Array) -> Array:
        """Its places where it crosses the other family at ``along``, of the same shape."""
        return np.full(np.shape(along), self.at)


@dataclass(frozen=True, kw_only=True, eq=False)
class CurvedLine(Line):
    """A line on a curve, which runs along the axis ``way``; ``known`` are places along it with their parameters."""

    path: BoundaryCurve
    way: int
    known: tuple[Array, Array]
    is_fixed: bool = True

    def place(self, along: Array) -> Array:
        """Its places, by Newton's method from the parameters between those that are known."""
        t = np.interp(along, *self.known)
        for _ in range(NEWTON_STEPS):
            places = self.path.evaluate(t)
            slope = places[2 + self.way]
            t = np.clip(t - (places[self.way] - along) / np.where(slope == 0.0, math.inf, slope), *self.path.ends)
        return np.asarray(self.path.evaluate(t)[1 - self.way])


@dataclass(frozen=True, kw_only=True, eq=False)
class LineThroughPoints(Line):
    """A line between two others, at a share of the way from one to the other that depends on the place along it."""

    between: tuple[Line, Line]
    known: tuple[Array, Array]
    """The places along it of its points, rising, and their shares; between these the share changes linearly."""

    def place(self, along: Array) -> Array:
        """Its places: it cannot meet the two lines."""
        low, high = (line.place(along) for line in self.between)
        return low + np.interp(along, *self.known) * (high - low)


def numbered(wanted: Sequence[float], low: int, high: int) -> list[int] | None:
    """Whole numbers that rise, above ``low`` and below ``high``, near those that are ``wanted``; None for too many."""
    found: list[int] = []
    for k, number_wanted in enumerate(wanted):
        least = (found[-1] if found else low) + 1
        found.append(min(max(round(number_wanted), least), high - (len(wanted) - k)))
        if found[-1] < least:
            return None
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Fixed:
    """What is fixed in a rectangle, checked."""

    box: tuple[Point, Point]
    cells: tuple[int, int]
    points: Sequence[Point]
    curves: Mapping[str, BoundaryCurve]
    layers: Mapping[str, Layers]
    lines: tuple[list[Line], list[Line]] = field(default_factory=lambda: ([], []))
    """The lines of constant x, then those of constant y, by their numbers."""
    through: tuple[dict[Point, Line], dict[Point, Line]] = field(default_factory=lambda: ({}, {}))
    """The line of each family on which a point is."""

    def place(self) -> None:
        """Find the lines: sides and layers, then curves, then those through points."""
        axis_of = {name: self._axis(name, curve) for name, curve in self.curves.items()}
        for axis in (0, 1):
            self._add_straight(axis)
            self._add_curves(axis, [name for name in self.curves if axis_of[name] == axis])
        places = [self._find_fixed(axis) for axis in (0, 1)]
        for axis in (0, 1):
            self._add_points(axis, places[axis])

    @property
    def _near(self) -> float:
        return NEAR * max(high - low for low, high in self.box)

    def _add_straight(self, axis: int) -> None:
        (low, high), n = self.box[axis], self.cells[axis]
        lines = self.lines[axis]
        for index, at, side, way in ((0, low, ENDS[1 - axis][0], 1), (n, high, ENDS[1 - axis][1], -1)):
            lines.append(Line(index=index, at=at))
            heights = self.layers[side].heights if side in self.layers else []
            for k, height in enumerate(heights, start=1):
                lines.append(Line(index=index + way * k, at=at + way * height, is_fixed=True))
        lines.sort(key=lambda line: line.at)
        if any(one.index >= other.index or one.at >= other.at for one, other in pairwise(lines)):
            side = next(side for side in ENDS[1 - axis] if side in self.layers)
            raise InputError(
                f"the layers of {side} do not fit: {n} cells over {high - low:g}; take fewer layers, thinner ones, or"
                " more cells",
                field=f"domain.layers.{side}",
            )

    def _axis(self, name: str, curve: BoundaryCurve) -> int:
        """The axis that has its places: 1 for one from left to right, 0 for one from bottom to top."""
        x, y, *_ = curve.evaluate(np.array(curve.ends))
        for axis, along in ((1, x), (0, y)):
            if np.abs(np.sort(along) - self.box[1 - axis]).max() < self._near:
                return axis
        raise InputError(
            f"the curve {name} runs from ({x[0]:.6g}, {y[0]:.6g}) to ({x[-1]:.6g}, {y[-1]:.6g}): let it run from the"
            " left side to the right one, or from the bottom to the top; a closed curve needs blocks around it",
            field=f"domain.curves.{name}",
        )

    def _add_curves(self, axis: int, names: Sequence[str]) -> None:
        """The lines of curves, each with the number that its mean place has without them."""
        straight, found = [*self.lines[axis]], list[tuple[float, str, tuple[Array, Array]]]()
        for name in names:
            t = np.linspace(*self.curves[name].ends, PLACES)
            places = self.curves[name].evaluate(t)
            order = np.argsort(places[1 - axis])
            found.append((float(places[axis].mean()), name, (places[1 - axis][order], t[order])))
        found.sort()
        ends = self.box[axis]
        for at, name, _ in found:
            if not ends[0] < at < ends[1]:
                raise InputError(
                    f"the curve {name} runs at {'xy'[axis]} = {at:.6g} in the mean, and the rectangle has"
                    f" {ends[0]:g} to {ends[1]:g}: let it run inside",
                    field=f"domain.curves.{name}",
                )
        for low, high in pairwise(straight):
            here = [one for one in found if low.at <= one[0] < high.at]
            wanted = [low.index + (at - low.at) / (high.at - low.at) * (high.index - low.index) for at, *_ in here]
            indices = numbered(wanted, low.index, high.index)
            if indices is None:
                raise InputError(
                    f"no line is left for the curve {here[-1][1]}: {REMEDY}", field=f"domain.curves.{here[-1][1]}"
                )
            self.lines[axis].extend(
                CurvedLine(index=index, curve=name, path=self.curves[name], way=1 - axis, known=known)
                for index, (_, name, known) in zip(indices, here, strict=True)
            )
        self.lines[axis].sort(key=lambda line: line.index)
        along = np.unique([places for _, _, (places, _) in found])
        of_lines = [line.place(along) for line in self.lines[axis]]
        for one, other, gap in zip(self.lines[axis], self.lines[axis][1:], np.diff(of_lines, axis=0), strict=False):
            meeting = along[gap <= self._near]
            if meeting.size:
                names_of = " and ".join(line.curve or "a straight line" for line in (one, other))
                raise InputError(
                    f"{names_of} meet near {'yx'[axis]} = {meeting[0]:.6g}: move one", field="domain.curves"
                )

    def _find_fixed(self, axis: int) -> Array:
        """The places of the lines so far at the points, shape ``(lines, points)``; notes which are on fixed ones."""
        along = np.array([at[1 - axis] for at in self.points])
        places = np.array([line.place(along) for line in self.lines[axis]])
        for line, row in zip(self.lines[axis], places, strict=True):
            for at, place in zip(self.points, row, strict=True):
                if line.is_fixed and abs(place - at[axis]) < self._near:
                    self.through[axis].setdefault(at, line)
        return places

    def _add_points(self, axis: int, places: Array) -> None:
        """The lines through the other points, which lie between ``places``. Near points may have one line."""
        fixed, through = [*self.lines[axis]], self.through[axis]
        gaps: dict[int, list[tuple[float, Point]]] = {}
        for at, here in zip(self.points, places.T, strict=True):
            if at not in through:
                k = int(np.count_nonzero(here < at[axis]))
                gaps.setdefault(k, []).append((float((at[axis] - here[k - 1]) / (here[k] - here[k - 1])), at))
        for k, inside in gaps.items():
            low, high = fixed[k - 1], fixed[k]
            count = high.index - low.index
            groups = self._groups(sorted(inside), count, axis)
            wanted = [low.index + count * float(np.mean([share for share, _ in group])) for group in groups]
            indices = numbered(wanted, low.index, high.index)
            if indices is None:
                at = groups[-1][0][1]
                raise InputError(
                    f"no line is left for the point ({at[0]:g}, {at[1]:g}): the lines of constant"
                    f" {'xy'[axis]} next to it are taken; {REMEDY}",
                    field="domain.points",
                )
            for index, group in zip(indices, groups, strict=True):
                known = np.array(sorted((at[1 - axis], share) for share, at in group)).T
                line = LineThroughPoints(index=index, between=(low, high), known=(known[0], known[1]))
                self.lines[axis].append(line)
                through |= {at: line for _, at in group}
        self.lines[axis].sort(key=lambda line: line.index)

    def _groups(self, inside: Sequence[tuple[float, Point]], count: int, axis: int) -> list[list[tuple[float, Point]]]:
        """Points with their shares, which rise, by common lines: those that are near, and more where lines are few."""
        groups: list[list[tuple[float, Point]]] = []
        for share, at in inside:
            is_near = bool(groups) and (share - groups[-1][0][0]) * count < LEAST_GAP
            if is_near and self._may_share(groups[-1], [(share, at)], axis):
                groups[-1].append((share, at))
            else:
                groups.append([(share, at)])
        while len(groups) >= count:
            pairs = [(k, one, two) for k, (one, two) in enumerate(pairwise(groups)) if self._may_share(one, two, axis)]
            if not pairs:
                break
            k, one, two = min(pairs, key=lambda pair: max(pair[2])[0] - min(pair[1])[0])
            groups[k : k + 2] = [one + two]
        return groups

    def _may_share(self, ones: Sequence[tuple[float, Point]], others: Sequence[tuple[float, Point]], axis: int) -> bool:
        """Whether points can have one line: at different places along it, and no other line in common."""
        lines = self.through[1 - axis]
        return all(
            one[1 - axis] != other[1 - axis] and (one not in lines or lines[one] is not lines.get(other))
            for (_, one), (_, other) in product(ones, others)
        )

    def _crossings(self) -> tuple[Array, set[tuple[int, int]]]:
        """Where the lines cross, shape ``(columns, rows, 2)``, and the crossings at points, which are there exactly."""
        columns, rows = self.lines
        x = np.array([np.repeat(line.place(np.array(np.mean(self.box[1]))), len(rows)) for line in columns])
        y, is_open = np.empty_like(x), np.ones(x.shape, dtype=bool)
        for _ in range(CROSSINGS):
            y = np.where(is_open, np.column_stack([row.place(x[:, j]) for j, row in enumerate(rows)]), y)
            found = np.array([column.place(y[i]) for i, column in enumerate(columns)])
            change, x = np.abs(found - x), np.where(is_open, found, x)
            is_open &= change >= CROSSED * self._near
            if not is_open.any():
                break
        crossings = np.stack([x, y], axis=-1)
        numbers = [{line: k for k, line in enumerate(lines)} for lines in self.lines]
        at_points = {(numbers[0][self.through[0][at]], numbers[1][self.through[1][at]]): at for at in self.points}
        for place, at in at_points.items():
            crossings[place] = at
        return crossings, set(at_points)

    def document(self) -> dict[str, Any]:
        """The description of the blocks between the lines."""
        columns, rows = self.lines
        count = (len(columns) - 1) * (len(rows) - 1)
        if count > MAX_BLOCKS:
            raise InputError(
                f"the lines of what is fixed cut the rectangle into {count} blocks: {MAX_BLOCKS} are possible; take"
                " fewer layers or points, or points on common lines",
                field="domain",
            )
        crossings, at_points = self._crossings()
        name = {(i, j): f"{columns[i].index},{rows[j].index}" for i, j in np.ndindex(len(columns), len(rows))}
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
            "vertices": {name[place]: crossings[place].tolist() for place in name},
            "edges": edges,
            "blocks": blocks,
            "sides": {side: sides[side] for side in SIDES},
            "corners": [name[place] for place in name if place in at_points],
            "fixed": fixed,
        }


def fixed_rectangle(
    x: object = (0.0, 1.0),
    y: object = (0.0, 1.0),
    cells: object = (32, 32),
    points: object = None,
    curves: object = None,
    layers: object = None,
    folder: Path | str | None = None,
) -> dict[str, Any]:
    """The description of blocks; the arguments are those of :meth:`equimesh.Blocks.rectangle`.

    Files of points of the curves lie in ``folder``.
    """
    box = point(x, "domain.x"), point(y, "domain.y")
    for name, (low, high) in zip("xy", box, strict=True):
        if not low < high:
            raise InputError(f"{name} = [{low:g}, {high:g}]: give two numbers that increase", field=f"domain.{name}")
    counts = entries(cells, "domain.cells", count=2, what=WANTED_CELLS)
    along_x, along_y = (whole(n, f"domain.cells[{k}]", MAX_CELLS) for k, n in enumerate(counts))
    places = [
        point(at, f"domain.points[{k}]")
        for k, at in enumerate(entries(() if points is None else points, "domain.points", what=WANTED_POINTS))
    ]
    if len(places) > MAX_POINTS:
        raise InputError(f"{len(places)} points: {MAX_POINTS} are possible; take fewer", field="domain.points")
    for k, at in enumerate(places):
        if not all(low < q < high for q, (low, high) in zip(at, box, strict=True)):
            (left, right), (bottom, top) = box
            sizes = f"x from {left:g} to {right:g}, y from {bottom:g} to {top:g}"
            here = f"points[{k}] = ({at[0]:g}, {at[1]:g})"
            raise InputError(f"{here} is not inside the rectangle: {sizes}", field=f"domain.points[{k}]")
        size = NEAR * max(high - low for low, high in box)
        if any(abs(at[0] - other[0]) < size and abs(at[1] - other[1]) < size for other in places[:k]):
            message = f"points[{k}] = ({at[0]:g}, {at[1]:g}) is there twice, or nearly: leave one out"
            raise InputError(message, field=f"domain.points[{k}]")
    given = (
        {}
        if curves is None
        else with_points(named(curves, "domain.curves", "a curve", CURVES), None if folder is None else Path(folder))
    )
    of = members({} if layers is None else layers, "domain.layers", SIDES, LAYERS)
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


@contextmanager
def between_fixed_lines() -> Iterator[None]:
    """Refusals of blocks that nobody has described, as refusals of what is fixed between them."""
    try:
        yield
    except InputError as error:
        if not (error.field or "").startswith("domain.blocks"):
            raise
        fault = str(error).partition(":")[0]
        raise InputError(
            f"the lines of what is fixed are too near or too steep: block {fault}; move points or curves apart, or"
            " take more cells",
            field="domain",
        ) from error
