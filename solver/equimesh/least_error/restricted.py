"""Restricted additive Schwarz for the objective: every region descends with the others held, and all moves are merged.

X.-C. Cai and M. Sarkis, *A restricted additive Schwarz preconditioner for general sparse linear systems*, SIAM J. Sci.
Comput. 21 (1999). In each exchange a region takes a few steps of descent for the objective of the whole mesh, in which
the other regions are constant. The merged mesh takes each node from the region that owns it. A merged mesh that has no
lower objective is drawn back to the one before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from equimesh.errors import InputError
from equimesh.least_error.cells import Region, regions_of
from equimesh.least_error.descent import MIN_JACOBIAN_SHARE, descend
from equimesh.least_error.objective import Objective
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Groups, Schwarz
from equimesh_schema.document import is_whole

SHORTENING = 0.5
"""The factor by which the merged moves are shortened where the mesh is no better."""
MAX_TRIALS = 6
"""Lengths of the merged moves that are tried."""


@dataclass(frozen=True)
class Merged:
    """The objective at a merged mesh."""

    value: float
    """The objective."""
    error: float
    """The norm of the interpolation error."""
    distortion: float
    """The mean of ``(r^2 - 1) / 2``."""
    smallest_share: float
    """The smallest Jacobian of a corner over that of the start."""


class RestrictedDescent:
    """The descent in the regions of a mesh with these numbers, ``here``, by default in all.

    The meshes do not depend on the number of the ``threads`` that share the regions.
    """

    def __init__(
        self, objective: Objective, regions: Sequence[Region], threads: int = 1, here: Sequence[int] | None = None
    ) -> None:
        self._regions, self._here = regions, range(len(regions)) if here is None else here
        self._threads = max(1, min(threads, len(self._here)))
        self._local = {k: objective.on(regions[k]) for k in self._here}
        self._weights = objective.weights
        self._corners, self._rounding = 4 * objective.cells.count, objective.rounding

    def descend(self, mesh: Array, exchanges: int, steps: int, min_decrease: float) -> Iterator[tuple[Array, Merged]]:
        """The merged meshes from ``mesh`` itself on, after each of at most ``exchanges``, with their objective.

        ``steps`` is how many steps a region takes in an exchange. Ends early where an exchange lowers the objective by
        less than ``min_decrease`` a step. Yields nothing where the error of ``mesh`` is rounding.
        """
        self._each(lambda k: self._local[k].cut(self._part(k, mesh)))
        now, squares = self._measured(mesh)
        if not math.isfinite(now.value):
            return
        yield mesh, now
        floor = min(MIN_JACOBIAN_SHARE, 0.9 * now.smallest_share)
        for _ in range(exchanges):
            moves = self._moves(mesh, squares, now.error**2, steps)
            length = 1.0
            for _ in range(MAX_TRIALS):
                moved = mesh + length * moves
                then, squares_then = self._measured(moved)
                if then.smallest_share > floor and then.value < now.value:
                    break
                length *= SHORTENING
            else:
                return
            decrease = now.value - then.value
            mesh, now, squares = moved, then, squares_then
            yield mesh, now
            if decrease < steps * min_decrease:
                return

    def whole(self, mesh: Array) -> Array:
        """The merged mesh with all nodes, also those of regions that are elsewhere."""
        return mesh

    def _joined(self, found: Array) -> Array:
        """What was found in all regions, along the first axis in their order."""
        return found

    def _complete(self, moves: Array) -> None:
        """Write the moves of nodes that the regions here need, and that regions elsewhere own."""

    def _owned(self, k: int) -> IntArray:
        """The nodes that a region owns, as numbers of the mesh."""
        return self._regions[k].nodes[self._regions[k].owned]

    def _part(self, k: int, mesh: Array) -> Array:
        """The nodes of a region, in an array in rows: loops would be compiled again for one in columns."""
        return np.ascontiguousarray(mesh[:, self._regions[k].nodes])

    def _each(self, work: Callable[[int], object]) -> None:
        """Do ``work`` for every region here, on the threads."""

        def share(thread: int) -> None:
            for k in self._here[thread :: self._threads]:
                work(k)

        run_on_threads(self._threads, share)

    def _measured(self, mesh: Array) -> tuple[Merged, dict[int, float]]:
        """The objective of a merged mesh, and the squared errors of the whole regions here.

        Sums are taken in the order of the regions.
        """
        found, squares = dict[int, tuple[float, ...]](), dict[int, float]()

        def measure(k: int) -> None:
            region = self._regions[k]
            sums = self._local[k].sums(self._part(k, mesh), region.own_cells, region.own_triples)
            found[k] = sums.square, sums.distortion, sums.bends, sums.obliqueness, sums.smallest_share
            squares[k] = sums.every_square

        self._each(measure)
        every = self._joined(np.array([found[k] for k in self._here]).reshape(-1, 5))
        square, distortion, bends, oblique = (float(np.sum(every[:, j])) for j in range(4))
        distortion, oblique = distortion / self._corners, oblique / self._corners
        if not self._rounding < math.sqrt(square) < math.inf:
            return Merged(math.inf, math.sqrt(square), distortion, -math.inf), squares
        weights = self._weights
        value = 0.5 * math.log(square) + weights.distortion * distortion + weights.smoothness * bends
        value += weights.obliqueness * oblique
        value = value if math.isfinite(value) else math.inf
        return Merged(value, math.sqrt(square), distortion, float(every[:, 4].min())), squares

    def _moves(self, mesh: Array, squares: dict[int, float], square: float, steps: int) -> Array:
        """The moves of all nodes that the regions here need: each from the region that owns the node."""
        moves = np.zeros_like(mesh)
        found = dict[int, Array]()

        def descend_in(k: int) -> None:
            region, objective = self._regions[k], self._local[k]
            start = self._part(k, mesh)
            objective.beyond = max(0.0, square - squares[k])
            found[k] = np.zeros((2, region.owned.size))
            for state, _ in descend(objective, start, steps, 0.0):
                found[k] = (state - start)[:, region.owned]

        self._each(descend_in)
        for k in self._here:
            moves[:, self._owned(k)] = found[k]
        self._complete(moves)
        return moves


# The subdomains of the finest mesh of a grid or of blocks.


@dataclass(frozen=True, kw_only=True)
class Subdomains:
    """Subdomains by their ``settings``."""

    settings: Schwarz

    def descend(
        self, objective: Objective, owner: IntArray, first: Array, exchanges: int, min_decrease: float, threads: int
    ) -> Iterator[tuple[Array, Merged]]:
        """The meshes after each exchange, from ``first`` on, with their objective.

        ``owner`` has the number of the subdomain of each cell, shape ``(cells,)``.
        """
        shared = self._restricted(objective, regions_of(objective.cells, owner, self.settings.overlap), threads)
        for merged, now in shared.descend(first, exchanges, self.settings.local_steps, min_decrease):
            yield shared.whole(merged), now

    def begin(self, weights: Sequence[float], start: Array, first: Array) -> None:
        """Called before a descent from ``first`` with these ``weights``, relative to the mesh ``start``."""

    def _restricted(self, objective: Objective, regions: Sequence[Region], threads: int) -> RestrictedDescent:
        return RestrictedDescent(objective, regions, threads)


def owners(settings: Schwarz, mesh: Mesh) -> IntArray:
    """The number of the subdomain that owns each cell of a mesh in blocks, shape ``(m,)``.

    Raises :class:`~equimesh.errors.InputError` for groups that do not have each block once; it names the block.
    """
    owner = np.empty(len(mesh.cells), dtype=np.int64)
    names = mesh.block_names
    groups = [[k] for k in range(len(names))] if settings.groups is None else list(_numbers(settings.groups, names))
    found: set[int] = set()
    for number, group in enumerate(groups):
        for block in group:
            if block in found:
                message = f"the block {names[block]} is in two groups: name each block once"
                raise InputError(message, field="schwarz.groups")
            found.add(block)
            owner[mesh.block_cells[block].ravel()] = number
    left = [name for k, name in enumerate(names) if k not in found]
    if left:
        raise InputError(f"the block {left[0]} is in no group: add it to one", field="schwarz.groups")
    return owner


def _numbers(groups: Groups, names: Sequence[str]) -> Iterator[list[int]]:
    """The numbers of the blocks of each group."""
    for k, group in enumerate(groups):
        yield [_number(block, names, f"schwarz.groups[{k}]") for block in group]


def _number(block: str | int, names: Sequence[str], field: str) -> int:
    """The number of a block that is given by its name or number."""
    if isinstance(block, str):
        if block in names:
            return names.index(block)
    elif is_whole(block) and 0 <= block < len(names):
        return int(block)
    known = ", ".join(names[:8]) + (" and others" if len(names) > 8 else "")
    raise InputError(f"there is no block {str(block)[:40]}: the blocks are {known}", field=field)
