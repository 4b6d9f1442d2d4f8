"""The objective as a function of straight lines: x of the reference square depends on xi alone, y on eta alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from equimesh.least_error.cells import Cells
from equimesh.least_error.objective import Evaluation, Objective
from equimesh.least_error.starts import product
from equimesh.numerics.types import Array


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
        """As :meth:`~equimesh.least_error.objective.Objective.cut`."""
        return self.objective.cut(self.mesh(lines))

    def tie(self, direction: Array) -> None:
        """Let the last line of a closed family move as the first, in place."""
        for axis, count in enumerate(self.shape):
            if self.objective.cells.closed[axis]:
                direction[axis, count - 1] = direction[axis, 0]

    def smallest_share(self, lines: Array) -> float:
        """As :meth:`~equimesh.least_error.objective.Objective.smallest_share`."""
        return self.objective.smallest_share(self.mesh(lines))

    def evaluate(self, lines: Array) -> Evaluation | None:
        """As :meth:`~equimesh.least_error.objective.Objective.evaluate`: a line moves all its nodes."""
        there = self.objective.evaluate(self.mesh(lines))
        if there is None:
            return None
        gradient, blocks = np.zeros_like(lines), np.zeros((3, lines.shape[1]))
        blocks[::2] = 1.0
        for axis, count in enumerate(self.shape):
            slopes, second = there.gradient[axis].reshape(self.shape), there.blocks[2 * axis].reshape(self.shape)
            gradient[axis, :count] = slopes.sum(axis=1 - axis)
            blocks[2 * axis, :count] = second.sum(axis=1 - axis)
        return replace(there, gradient=gradient, blocks=blocks)
