"""Overlapping decomposition of the computational grid into strips or blocks."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from equimesh.errors import DecompositionError
from equimesh.meshes.grid import Grid
from equimesh.numerics.types import IntArray

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
        """All subdomains, those of one column of blocks next to each other."""
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
    """How many shared lines there are before a cut and after it."""
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
