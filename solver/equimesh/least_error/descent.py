"""Descent on one mesh, of its nodes or of its straight lines, and the records of its steps.

J. Nocedal and S. J. Wright, *Numerical Optimization* (Springer, 2006), algorithm 7.4. The Armijo condition and a floor
of the Jacobian decide how far a step goes, so that every mesh is valid, and its objective lower than that before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from equimesh.inputs import finite_or_none
from equimesh.least_error.cells import Cells
from equimesh.least_error.objective import Evaluation, Objective
from equimesh.least_error.quasi_newton import History, slope_along
from equimesh.least_error.starts import product
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.types import Array

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


PAIRS = 8
"""Moves, and the changes of the gradient by them, that are kept."""
STEPS_A_PRECONDITIONER = 5
"""Steps after which the blocks are renewed."""
MAX_MOVE_CELLS = 2.0
"""The longest move of a coordinate in one step, in spacings of a mesh with equal cells."""
SHORTENING = 0.4
"""The factor by which a step that was not accepted is shortened."""
MAX_TRIALS = 9
"""Lengths of a step that are tried."""
MIN_DECREASE_SHARE = 1e-4
"""The share of the expected decrease that a step must reach: the Armijo condition."""
MIN_JACOBIAN_SHARE = 1e-4
"""The smallest Jacobian of a corner relative to the start; lower only where the first mesh has less."""
PATIENCE = 3
"""Steps over which the mean decrease is taken that ends the descent."""


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

    def tie(self, direction: Array) -> None:
        """Let the copies of tied nodes move as their originals, in place."""
        ...

    def smallest_share(self, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the start; not positive for a folded mesh."""
        ...

    def evaluate(self, mesh: Array, floor: float | None = None) -> Evaluation | None:
        """The objective with its derivatives; ``None`` where it has none, or a Jacobian is below the ``floor``."""
        ...


def descend(objective: Minimised, mesh: Array, steps: int, min_decrease: float) -> Iterator[tuple[Array, Evaluation]]:
    """The meshes of a descent with their evaluations, from ``mesh`` itself on; at most ``steps`` steps.

    Ends early where a step lowers the objective by less than ``min_decrease`` in the mean of the last ``PATIENCE``, or
    not at all. Yields nothing where the objective cannot be evaluated at ``mesh``: u is then interpolated exactly.
    Triangles are cut anew with every preconditioner; the objective can rise there.
    """
    now, history = objective.evaluate(mesh), History(mesh.size, max(1, min(PAIRS, steps)))
    if now is None:
        return
    yield mesh, now
    floor = min(MIN_JACOBIAN_SHARE, 0.9 * objective.smallest_share(mesh))
    blocks, values = now.blocks, [now.value]
    for step in range(steps):
        if step % STEPS_A_PRECONDITIONER == 0:
            if step > 0 and objective.cut(mesh):
                now = objective.evaluate(mesh) or now
            blocks = now.blocks
        found = search(objective, mesh, now, history.direction(now.gradient, blocks), floor)
        if found is None and not history.is_empty:
            history.clear()
            blocks = now.blocks
            found = search(objective, mesh, now, history.direction(now.gradient, blocks), floor)
        if found is None:
            return
        moved, then = found
        history.add(mesh, moved, now.gradient, then.gradient)
        mesh, now = moved, then
        yield mesh, now
        values.append(now.value)
        if len(values) > PATIENCE and values[-1 - PATIENCE] - values[-1] < PATIENCE * min_decrease:
            return


def search(
    objective: Minimised, mesh: Array, now: Evaluation, direction: Array, floor: float
) -> tuple[Array, Evaluation] | None:
    """The mesh at an accepted length along minus ``direction``, with its evaluation; ``None`` where there is none."""
    objective.tie(direction)
    slope, longest = slope_along(np.ascontiguousarray(now.gradient).reshape(-1), direction.reshape(-1))
    if not (slope > 0.0 and math.isfinite(longest)):
        return None
    length = min(1.0, MAX_MOVE_CELLS * objective.length / math.sqrt(objective.cells.count) / longest)
    for _ in range(MAX_TRIALS):
        moved = mesh - length * direction
        then = objective.evaluate(moved, floor)
        if then is not None and then.value <= now.value - MIN_DECREASE_SHARE * length * slope:
            return moved, then
        length *= SHORTENING
    return None


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

    def tie(self, direction: Array) -> None:
        """Let the last line of a closed family move as the first, in place."""
        for axis, count in enumerate(self.shape):
            if self.objective.cells.closed[axis]:
                direction[axis, count - 1] = direction[axis, 0]

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
