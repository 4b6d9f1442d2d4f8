"""Descent on one mesh, of its nodes or of its straight lines, and the records of its steps.

The Armijo condition and a floor of the Jacobian decide how far a step goes, so that every mesh is valid, and its
objective lower than that before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from equimesh.inputs import finite_or_none
from equimesh.least_error.cells import Cells
from equimesh.least_error.evaluation import KNOWN, OPEN, Evaluation, Parts, Result, evaluate
from equimesh.least_error.objective import Objective
from equimesh.least_error.quasi_newton import (
    EVALUATE,
    HERE,
    OVER,
    RENEW,
    RESULTS,
    STEPS,
    TAKEN,
    Way,
    advance,
    way_from,
)
from equimesh.least_error.starts import product
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

# The record of one step of a least-error solve.


@dataclass(frozen=True, kw_only=True)
class Descent:
    """The record of one step of descent. The mesh is one of the reference square, or of a domain in blocks."""

    level: int
    """The number of the nested grid, 0 for the coarsest."""
    levels: int
    """How many nested grids there are."""
    grid: Grid | None
    """The grid of the level; ``None`` on a domain in blocks, whose meshes have none."""
    step: int
    """The number of the step on its level, 0 for its first mesh."""
    steps: int
    """How many steps the level has at most."""
    error: float
    """The norm of the interpolation error, by the quadrature of the level."""
    gain: float | None
    """The error of the uniform or initial mesh over ``error``; ``None`` on fine grids, where it takes long."""
    distortion: float
    """The mean distortion of the cells relative to the first mesh of the way, 0 for that mesh."""
    min_jacobian: float
    """The smallest Jacobian of a corner on the domain, relative to the uniform mesh.

    On a domain in blocks relative to the same corner of the initial mesh.
    """
    mesh: Mesh
    """The mesh of the reference square, or that of the domain in blocks."""
    start: str
    """The first mesh: ``"uniform"``, ``"rectilinear"`` or ``"given"``; on a domain in blocks ``"initial"``."""
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    @property
    def points(self) -> int:
        """Points of the level."""
        return int(self.mesh.x.size)

    def numbers(self) -> dict[str, Any]:
        """The record without the mesh, as plain Python data, ready for JSON."""
        return {
            "level": self.level,
            **({"points": self.points} if self.grid is None else {"grid": [self.grid.n_xi, self.grid.n_eta]}),
            "start": self.start,
            "step": self.step,
            **{name: finite_or_none(getattr(self, name)) for name in ("error", "gain", "distortion", "min_jacobian")},
        }


MAX_MOVE_CELLS = 2.0
"""The longest move of a coordinate in one step, in spacings of a mesh with equal cells."""
MIN_JACOBIAN_SHARE = 1e-4
"""The smallest Jacobian of a corner relative to the start; lower only where the first mesh has less."""
MAX_KEPT_POINTS = 129 * 129
"""Points of a mesh whose steps are taken in one compiled call; those of a finer one are told one by one."""


class Minimised(Protocol):
    """What a descent makes small: an objective of all nodes, or of straight lines."""

    @property
    def cells(self) -> Cells:
        """The cells of the mesh."""
        ...

    @property
    def length(self) -> float:
        """The size of the domain in the units of the unknowns."""
        ...

    def cut(self, mesh: Array) -> bool:
        """Cut triangles anew; whether the cuts are others than before."""
        ...

    @property
    def ties(self) -> IntArray:
        """Pairs of unknowns that move together, a copy and its original: numbers of a flat array, ``(ties, 2)``."""
        ...

    @property
    def parts(self) -> Parts | None:
        """What compiled code evaluates it from; ``None`` where it cannot."""
        ...

    @property
    def beyond(self) -> float:
        """The squared error of further cells that do not change."""
        ...

    def smallest_share(self, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the start; not positive for a folded mesh."""
        ...

    def evaluate(self, mesh: Array, floor: float | None = None) -> Evaluation | None:
        """The objective with its derivatives; ``None`` where it has none, or a Jacobian is below the ``floor``."""
        ...


def descend(objective: Minimised, mesh: Array, steps: int, min_decrease: float) -> Iterator[tuple[Array, Result]]:
    """The meshes of a descent with their results, from ``mesh`` itself on; at most ``steps`` steps.

    Ends early where a step lowers the objective by less than ``min_decrease`` in the mean of the last few, or not at
    all. Yields nothing where the objective cannot be evaluated at ``mesh``: u is then interpolated exactly. Triangles
    are cut anew with every preconditioner; the objective can rise there.
    """
    first = objective.evaluate(mesh)
    if first is None:
        return
    yield mesh, first.result
    floor = min(MIN_JACOBIAN_SHARE, 0.9 * objective.smallest_share(mesh))
    max_move = MAX_MOVE_CELLS * objective.length / math.sqrt(objective.cells.count)
    way, parts = way_from(mesh, objective.ties, steps, max_move, min_decrease), objective.parts
    write(way, way.here, first)
    is_known, need = False, RENEW
    while need != OVER:
        if parts is None:
            need = advance(way, is_known)
        else:
            taken = Taken.of(mesh, steps)
            need, count = take_steps(way, parts, objective.beyond, floor, is_known, taken)
            for k in range(count):
                yield taken.meshes[k], Result(*taken.results[k].tolist())
        if need == EVALUATE:
            parts = None  # where a slope is infinite at a node it is most often so in the next step, too
            mesh = way.trial.copy()
            then = objective.evaluate(mesh, floor)
            is_known = then is not None
            if then is not None:
                write(way, 1 - way.here, then)
        elif need == TAKEN and parts is None:
            yield mesh, Result(*way.results[way.here].tolist())
        elif need == RENEW and way.counts[STEPS] > 0 and objective.cut(mesh):
            anew = objective.evaluate(mesh)
            if anew is not None:
                write(way, way.here, anew)


def write(way: Way, place: int, found: Evaluation) -> None:
    """Write what was found for a mesh of the descent."""
    way.gradients[place], way.blocks[place] = found.gradient, found.blocks
    way.results[place] = found.value, found.error, found.distortion


class Taken(NamedTuple):
    """The meshes of some steps, shape ``(steps, 2, nodes)``, and their results."""

    meshes: Array
    results: Array

    @classmethod
    def of(cls, mesh: Array, steps: int) -> Taken:
        """Memory for so many steps, or for one of a fine mesh."""
        at_once = max(1, steps if mesh.shape[1] <= MAX_KEPT_POINTS else 1)
        return cls(np.empty((at_once, *mesh.shape)), np.empty((at_once, RESULTS)))


@compiled
def take_steps(way: Way, parts: Parts, beyond: float, floor: float, is_known: bool, taken: Taken) -> tuple[int, int]:
    """Take as many steps as have a place, until the descent is over, or needs what compiled code cannot tell.

    Returns what it needs, :data:`~equimesh.least_error.quasi_newton.TAKEN` for more places, and how many steps it took.
    """
    count = 0
    while True:
        need = advance(way, is_known)
        if need == EVALUATE:
            there = 1 - way.counts[HERE]
            out = way.gradients[there], way.blocks[there], way.results[there]
            found = evaluate(parts, beyond, way.meshes[there], floor, out[0], out[1], out[2])
            if found == OPEN:
                return need, count
            is_known = found == KNOWN
        elif need == TAKEN:
            here = way.counts[HERE]
            copy(way.meshes[here], taken.meshes[count])
            for k in range(RESULTS):
                taken.results[count, k] = way.results[here, k]
            count += 1
            if count == taken.meshes.shape[0]:
                return need, count
        elif need == OVER:
            return need, count


@compiled
def copy(rows: Array, out: Array) -> None:
    """Copy all numbers."""
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            out[k, j] = rows[k, j]


# The objective as a function of straight lines: x of the reference square depends on xi alone, y on eta alone.


@dataclass(frozen=True, eq=False)
class StraightLines:
    """An objective of rectilinear meshes with this ``shape``.

    Lines are an array of shape ``(2, max(shape))``: the positions of the lines along s, then those along t, each
    followed by zeros that nothing depends on.
    """

    objective: Objective
    shape: tuple[int, int]

    @property
    def cells(self) -> Cells:
        """The cells of the mesh."""
        return self.objective.cells

    @property
    def length(self) -> float:
        """The size of the domain in the units of the unknowns."""
        return self.objective.length

    def lines(self, mesh: Array) -> Array:
        """The lines of a rectilinear mesh of shape ``(2, nodes)``: those through the nodes of two sides."""
        lines = np.zeros((2, max(self.shape)))
        lines[0, : self.shape[0]] = mesh[0].reshape(self.shape)[:, 0]
        lines[1, : self.shape[1]] = mesh[1].reshape(self.shape)[0]
        return lines

    def mesh(self, lines: Array) -> Array:
        """The rectilinear mesh of these lines, shape ``(2, nodes)``."""
        return product(*(line[:count] for line, count in zip(lines, self.shape, strict=True)))

    def cut(self, lines: Array) -> bool:
        """See :meth:`~equimesh.least_error.objective.Objective.cut`."""
        return self.objective.cut(self.mesh(lines))

    @property
    def ties(self) -> IntArray:
        """The last line of a closed family moves as the first."""
        most = max(self.shape)
        ends = [(axis * most + count - 1, axis * most) for axis, count in enumerate(self.shape)]
        closed = [end for end, is_closed in zip(ends, self.objective.cells.closed, strict=True) if is_closed]
        return np.array(closed, dtype=np.int64).reshape(-1, 2)

    @property
    def parts(self) -> None:
        """Nothing: compiled code knows no lines."""

    @property
    def beyond(self) -> float:
        """See :attr:`~equimesh.least_error.objective.Objective.beyond`."""
        return self.objective.beyond

    def smallest_share(self, lines: Array) -> float:
        """See :meth:`~equimesh.least_error.objective.Objective.smallest_share`."""
        return self.objective.smallest_share(self.mesh(lines))

    def evaluate(self, lines: Array, floor: float | None = None) -> Evaluation | None:
        """See :meth:`~equimesh.least_error.objective.Objective.evaluate`; a line moves all its nodes."""
        there = self.objective.evaluate(self.mesh(lines), floor)
        if there is None:
            return None
        gradient, blocks = np.zeros_like(lines), np.zeros((3, lines.shape[1]))
        blocks[::2] = 1.0
        for axis, count in enumerate(self.shape):
            slopes, second = there.gradient[axis].reshape(self.shape), there.blocks[2 * axis].reshape(self.shape)
            gradient[axis, :count] = slopes.sum(axis=1 - axis)
            blocks[2 * axis, :count] = second.sum(axis=1 - axis)
        return replace(there, gradient=gradient, blocks=blocks)
