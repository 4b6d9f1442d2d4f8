"""Overlapping decomposition of the computational grid into strips or blocks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from equimesh.errors import DecompositionError
from equimesh.meshes.mesh import Grid, Mesh, largest_difference
from equimesh.numerics.types import IntArray
from equimesh.sweeps.sweep import Frame

MIN_OVERLAP = 2
DIRECTIONS = (("xi", "columns"), ("eta", "rows"))

Cuts: TypeAlias = tuple[int, ...]
"""Grid lines at which subdomains meet in one direction, in ascending order."""


@dataclass(frozen=True)
class Span:
    """The grid lines ``first`` to ``last``, both included, that a subdomain covers in one direction.

    In the merged mesh it owns the lines ``owned_first`` to ``owned_last``.
    """

    first: int
    last: int
    owned_first: int
    owned_last: int

    @property
    def size(self) -> int:
        """Number of grid lines."""
        return self.last - self.first + 1


@dataclass(frozen=True)
class Subdomain:
    """One rectangle of grid points; ``place`` is its (column, row) in the decomposition."""

    number: int
    place: tuple[int, int]
    spans: tuple[Span, Span]

    @property
    def columns(self) -> range:
        """The grid columns (index along xi) of the subdomain."""
        return range(self.spans[0].first, self.spans[0].last + 1)

    @property
    def rows(self) -> range:
        """The grid rows (index along eta) of the subdomain."""
        return range(self.spans[1].first, self.spans[1].last + 1)

    @property
    def owned(self) -> tuple[slice, slice]:
        """The nodes that the merged mesh takes from the subdomain."""
        xi, eta = self.spans
        return slice(xi.owned_first, xi.owned_last + 1), slice(eta.owned_first, eta.owned_last + 1)


@dataclass(frozen=True, kw_only=True)
class Decomposition:
    """``subdomains = (along xi, along eta)`` overlapping rectangles, of nearly equal size unless ``cuts`` are given.

    Neighbours share ``overlap`` grid lines (points): with 2 subdomains of 12 columns and an overlap of 2 they are
    columns 0..6 and 5..11, as in the paper's Table 1. In the merged mesh the owner changes in the middle of the
    overlap. ``cuts`` along xi and along eta are the lines at which subdomains meet, one fewer than there are
    subdomains; the overlap is then laid around them. They are ``None`` in a direction of equal sizes.

    Raises :class:`~equimesh.errors.DecompositionError` when the numbers do not fit the grid.
    """

    grid: Grid
    subdomains: tuple[int, int] = (2, 1)
    overlap: int = 4
    cuts: tuple[Cuts | None, Cuts | None] = (None, None)

    def __post_init__(self) -> None:
        if self.overlap < MIN_OVERLAP:
            raise DecompositionError(
                f"overlap = {self.overlap}: neighbouring subdomains must share at least {MIN_OVERLAP} points",
                field="overlap",
            )
        directions = zip(DIRECTIONS, self.grid.shape, self.subdomains, self.cuts, strict=True)
        for (direction, lines), points, count, cuts in directions:
            _check(direction, lines, points, count, self.overlap)
            if cuts is not None:
                _check_cuts(direction, points, count, cuts, self.overlap)

    @cached_property
    def spans(self) -> tuple[tuple[Span, ...], tuple[Span, ...]]:
        """The spans of the columns and of the rows of subdomains."""
        xi, eta = (
            _spans(points, count, self.overlap) if cuts is None else _spans_at(cuts, points, self.overlap)
            for points, count, cuts in zip(self.grid.shape, self.subdomains, self.cuts, strict=True)
        )
        return xi, eta

    @cached_property
    def parts(self) -> tuple[Subdomain, ...]:
        """The subdomains, column by column."""
        along_xi, along_eta = self.spans
        places = [(i, j) for i in range(len(along_xi)) for j in range(len(along_eta))]
        return tuple(Subdomain(number, (i, j), (along_xi[i], along_eta[j])) for number, (i, j) in enumerate(places))

    def at(self, column: int, row: int) -> Subdomain:
        """The subdomain at a place of the decomposition."""
        return self.parts[column * self.subdomains[1] + row]

    def owner_of_cells(self) -> IntArray:
        """The number of the subdomain that owns each cell's first corner, shape ``(n_xi - 1, n_eta - 1)``."""
        owner = np.empty(self.grid.shape, dtype=np.int64)
        for part in self.parts:
            owner[part.owned] = part.number
        return owner[:-1, :-1]


def _check(direction: str, lines: str, points: int, count: int, overlap: int) -> None:
    if count < 1:
        raise DecompositionError(f"{count} subdomains in {direction}: at least 1 is needed", field="subdomains")
    # Every subdomain is wider than the overlap exactly when their number plus the overlap is at most the grid.
    if count == 1 or count + overlap <= points:
        return
    widest = points - count
    by_overlap = f", and {count} subdomains an overlap of at most {widest}" if widest >= MIN_OVERLAP else ""
    raise DecompositionError(
        f"{count} subdomains in {direction} with an overlap of {overlap} points do not fit {points} {lines}: every "
        f"subdomain must be wider than the overlap. This overlap allows at most {max(points - overlap, 1)} "
        f"subdomains{by_overlap}; or take more grid points",
        field="overlap" if by_overlap else "subdomains",
    )


def _check_cuts(direction: str, points: int, count: int, cuts: Cuts, overlap: int) -> None:
    """Refuse lines in no ascending order, or so near to a side that the overlap would reach over it."""
    if len(cuts) != count - 1 or any(here >= there for here, there in pairwise(cuts)):
        raise DecompositionError(
            f"the cuts {list(cuts)} in {direction}: give each line once, in ascending order, one line fewer than there"
            " are subdomains",
            field="subdomains",
        )
    before, after = _around(overlap)
    first, last = before + 1, points - 2 - after
    outside = [cut for cut in cuts if not first <= cut <= last]
    if outside:
        raise DecompositionError(
            f"subdomains meet at line {outside[0]} in {direction}: with an overlap of {overlap} points the lines"
            f" {first} to {last} can be cuts; take one of those, or a smaller overlap",
            field="subdomains",
        )


def _around(overlap: int) -> tuple[int, int]:
    """The numbers of shared lines before a cut and after it."""
    before = (overlap - 1) // 2
    return before, overlap - 1 - before


def _spans_at(cuts: Cuts, points: int, overlap: int) -> tuple[Span, ...]:
    """The spans between ``cuts``; the subdomain after a cut owns its line."""
    before, after = _around(overlap)
    firsts, lasts = [0, *(cut - before for cut in cuts)], [*(cut + after for cut in cuts), points - 1]
    owned = [0, *cuts, points]
    return tuple(Span(firsts[k], lasts[k], owned[k], owned[k + 1] - 1) for k in range(len(firsts)))


def _spans(points: int, count: int, overlap: int) -> tuple[Span, ...]:
    size, larger = divmod(points + (count - 1) * overlap, count)
    firsts, lasts, first = [], [], 0
    for k in range(count):
        last = first + size + (k < larger) - 1
        firsts.append(first)
        lasts.append(last)
        first = last + 1 - overlap
    # The owner changes in the middle of the overlap, towards its start: with 2 points, at the second's first line.
    cuts = [0, *(f + (overlap - 2) // 2 for f in firsts[1:]), points]
    return tuple(Span(firsts[k], lasts[k], cuts[k], cuts[k + 1] - 1) for k in range(count))


# The window of the grid that a subdomain is solved on: its own points and the lines beyond its interfaces.

Place: TypeAlias = tuple[slice, slice]
"""A rectangle of grid points."""
AXES = (0, 1)
ENDS = (0, 1)


class SubdomainWindow:
    """The grid lines of a subdomain and ``ghosts`` more beyond every interface.

    ``open`` tells by (axis, end) which sides are interfaces. ``first`` is the window's lowest grid point, ``slices``
    its place in the grid, ``shape`` its size. A state is a :class:`~equimesh.meshes.mesh.Mesh` of this shape.
    """

    def __init__(self, decomposition: Decomposition, part: Subdomain, ghosts: int) -> None:
        self.part = part
        self.open = {
            (axis, end): 0 <= part.place[axis] + (1 if end else -1) < decomposition.subdomains[axis]
            for axis in AXES
            for end in ENDS
        }
        self.first = tuple(part.spans[axis].first - ghosts * self.open[axis, 0] for axis in AXES)
        last = tuple(part.spans[axis].last + ghosts * self.open[axis, 1] for axis in AXES)
        self.slices = tuple(slice(self.first[axis], last[axis] + 1) for axis in AXES)
        self.shape = (last[0] - self.first[0] + 1, last[1] - self.first[1] + 1)

    @property
    def physical(self) -> tuple[tuple[bool, bool], tuple[bool, bool]]:
        """Which sides lie on the boundary of the domain, by axis and end."""
        xi, eta = ((not self.open[axis, 0], not self.open[axis, 1]) for axis in AXES)
        return xi, eta

    @property
    def covered(self) -> tuple[slice, slice]:
        """The points of the subdomain in the grid: its own points and the overlap."""
        columns, rows = self.part.columns, self.part.rows
        return slice(columns.start, columns.stop), slice(rows.start, rows.stop)

    def frame(self, points: tuple[int, int]) -> Frame:
        """The frame of the window in a grid of this many ``points``, with the edges beyond its interfaces."""
        lower = [float(self.part.spans[axis].first) * self.open[axis, 0] for axis in AXES]
        upper = [float(points[axis] - 1 - self.part.spans[axis].last) * self.open[axis, 1] for axis in AXES]
        return Frame(physical=self.physical, beyond=((lower[0], upper[0]), (lower[1], upper[1])))

    def restrict(self, mesh: Mesh) -> Mesh:
        """The window's part of a mesh of the whole grid."""
        columns, rows = self.slices
        return Mesh(mesh.x[columns, rows].copy(), mesh.y[columns, rows].copy())

    def write(self, state: Mesh, mesh: Mesh, place: tuple[slice, slice]) -> None:
        """Write the nodes at a place of the grid into a mesh of the whole grid."""
        local = self.local(place)
        mesh.x[place], mesh.y[place] = state.x[local], state.y[local]

    def distance(self, state: Mesh, mesh: Mesh) -> tuple[float, float]:
        """Largest difference in x and in y to a mesh of the whole grid, on the subdomain without its ghosts."""
        place = self.covered
        local = self.local(place)
        return (
            largest_difference(state.x[local], mesh.x[place]),
            largest_difference(state.y[local], mesh.y[place]),
        )

    def local(self, place: tuple[slice, slice]) -> tuple[slice, slice]:
        """A place of the grid as one of the window."""
        xi, eta = (slice(cut.start - first, cut.stop - first) for cut, first in zip(place, self.first, strict=True))
        return xi, eta


# Rectangles of grid points: what two of them share, and the lines around a subdomain.


def common(one: Place, other: tuple[slice, ...]) -> Place | None:
    """The rectangle that two share; ``None`` where they share no point."""
    xi, eta = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return (xi, eta) if xi.start < xi.stop and eta.start < eta.stop else None


def points(place: Place | None) -> int:
    """The number of grid points of a rectangle."""
    return 0 if place is None else (place[0].stop - place[0].start) * (place[1].stop - place[1].start)


def rim(window: SubdomainWindow) -> dict[tuple[int, int], Place]:
    """The grid points of a window beyond its interfaces, by the step to the neighbour that covers them."""
    cuts = []
    for axis in AXES:
        covered = window.covered[axis]
        here = {0: covered}
        for end in ENDS:
            if window.open[axis, end]:
                beyond = slice(covered.stop, covered.stop + 1) if end else slice(covered.start - 1, covered.start)
                here[1 if end else -1] = beyond
        cuts.append(here)
    return {(i, j): (cuts[0][i], cuts[1][j]) for i in cuts[0] for j in cuts[1] if (i, j) != (0, 0)}


# The turns of a Schwarz iteration: which subdomains are solved at the same time, and in which order.


def turns(decomposition: Decomposition, ordering: Ordering) -> list[list[int]]:
    """The numbers of the subdomains of every turn. Subdomains of one turn read the same data."""
    numbers = [part.number for part in decomposition.parts]
    if ordering is Ordering.PARALLEL:
        return [numbers]
    if ordering is Ordering.COLOURED:
        return _colours(decomposition)
    forward = [[number] for number in numbers]
    return forward if ordering is Ordering.ALTERNATING else [*forward, *forward[-2::-1]]


def _colours(decomposition: Decomposition) -> list[list[int]]:
    """Every other subdomain along xi and along eta."""
    found: dict[tuple[int, int], list[int]] = {}
    for part in decomposition.parts:
        found.setdefault((part.place[0] % 2, part.place[1] % 2), []).append(part.number)
    return [found[colour] for colour in sorted(found)]


class Ordering(StrEnum):
    """Which subdomains are solved at the same time; it determines the data that they read.

    ``PARALLEL``: all, with data of the previous iteration (the default). ``ALTERNATING``: one after the other, with the
    newest data, as in the paper. ``SYMMETRIC``: the same, first forward and then backward. ``COLOURED``: every other
    strip, or every other block in both directions, at the same time: two or four turns an iteration.
    """

    PARALLEL = "parallel"
    ALTERNATING = "alternating"
    SYMMETRIC = "symmetric"
    COLOURED = "coloured"
