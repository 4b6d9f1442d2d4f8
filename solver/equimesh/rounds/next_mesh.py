"""The mesh for the next solve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from equimesh.least_error.kernels import Norm
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh_coupling.display import draw_on, picture
from equimesh_schema import ErrorProducts
from equimesh_schema.notebook import html_of

KEPT = "kept"
"""The name of the mesh before, where no candidate is valid or the values are linear in x and y."""


def moved_cells(before: Mesh, after: Mesh) -> float:
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh of the square.

    On blocks in sides of a square with the area of the mean cell.
    """
    if not before.is_grid:
        size = float(np.mean(before.cell_areas()))
        moves = np.sum((after.points - before.points) ** 2, axis=1)
        return math.sqrt(float(np.mean(moves)) / size)
    spacing: Array = np.array([n - 1 for n in before.grid.shape], dtype=float)
    moves = np.stack([after.x - before.x, after.y - before.y], axis=-1) * spacing
    return float(np.sqrt(np.mean(np.sum(moves**2, axis=-1))))


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMesh:
    """The mesh for the next solve."""

    reference: Mesh
    """The mesh for the next solve on the reference square; of blocks the mesh itself."""
    chosen: str
    """The name of the candidate that was chosen."""
    norm: Norm
    """The norm in which it was chosen: the requested one, or L2 on blocks that do not resolve the solution."""
    candidates: Mapping[str, float]
    """The candidates, with the errors of the recovered u on them in that norm: of its interpolant, or of a solver.

    In L2 the error is that of a solver where :attr:`ErrorEstimate.is_for_solver` says so.
    """
    gain: float
    """The same error on the mesh before over that on this one.

    Both are measured at the same points of each cell, which are fewer than those of the estimate. Where the values do
    not resolve the solution it can be below 1.
    """
    moved_cells: float
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh, on blocks in lengths of the mean
    cell.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """The next mesh, and the estimated error of the values on their own mesh."""

    mesh: Mesh
    """The next mesh of the domain, with as many nodes."""
    reference: Mesh
    """The same mesh on the reference square; of blocks the mesh itself."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, 0 where that is nothing but rounding."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. A mesh that resolves nothing has a small one."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    chosen: str
    """As :attr:`NextMesh.chosen`."""
    norm: Norm
    """As :attr:`NextMesh.norm`."""
    candidates: Mapping[str, float]
    """As :attr:`NextMesh.candidates`."""
    gain: float
    """As :attr:`NextMesh.gain`."""
    moved_cells: float
    """As :attr:`NextMesh.moved_cells`."""
    products: ErrorProducts | None = None
    """What tells the error of a functional, where its adjoint is given."""

    def plot(self, axes: Any = None) -> Any:
        """Draw the next mesh on ``axes`` of matplotlib, or on those of pyplot, and return the axes."""
        return draw_on(self.mesh, None, axes)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        facts = [
            ("estimated error", f"{self.estimate:.3g} in L2, {self.estimate_h1:.3g} in H1, of the values given"),
            ("unresolved", f"{self.unresolved:.0%} of the gradient"),
            ("chosen", self.chosen),
            ("moved", f"{self.moved_cells:.2g} cells"),
        ]
        return html_of("The next mesh", facts, picture=picture(self.mesh), alternative="the next mesh")
