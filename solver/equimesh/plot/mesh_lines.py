"""The lines of a mesh in a picture: all, or every k-th, and the subdomain of each edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.decomposition import Decomposition

SHARED_OWNER = -1
"""The owner of edges that several subdomains hold."""


@dataclass(frozen=True, eq=False)
class MeshLines:
    """The mesh lines at indices ``columns`` along xi and ``rows`` along eta, and the nodes where they cross.

    ``x``, ``y`` have shape ``(len(columns), len(rows))``; ``step`` is 1 when all lines are chosen.
    """

    x: Array
    y: Array
    columns: IntArray
    rows: IntArray
    step: int

    @classmethod
    def of(cls, mesh: Mesh, *, most: int, decomposition: Decomposition | None = None) -> MeshLines:
        """About ``most`` lines in a direction; the sides, and the ends of subdomains, always among them."""
        step = max(1, math.ceil((max(mesh.x.shape) - 1) / most))
        spans = [(part.columns, part.rows) for part in decomposition.parts] if decomposition else []
        columns, rows = (
            np.unique([*range(0, n, step), n - 1, *(end for span in spans for end in (span[k][0], span[k][-1]))])
            for k, n in enumerate(mesh.x.shape)
        )
        window = np.ix_(columns, rows)
        return cls(mesh.x[window], mesh.y[window], columns, rows, step)

    @property
    def remark(self) -> str:
        """The remark of a title on lines that are left out; empty when there are none."""
        return remark_on(self.step)

    def owners(self, of_cell: IntArray, decomposition: Decomposition | None) -> tuple[IntArray, IntArray]:
        """The subdomain of every drawn edge along xi and along eta, ``SHARED_OWNER`` where several hold its ends.

        Without a decomposition, the subdomain that a neighbouring cell was taken from.
        """
        i, j = self.columns, self.rows
        along_xi = of_cell[np.ix_(i[:-1], np.minimum(j, of_cell.shape[1] - 1))]
        along_eta = of_cell[np.ix_(np.minimum(i, of_cell.shape[0] - 1), j[:-1])]
        if decomposition is None:
            return along_xi, along_eta
        holders = np.zeros_like(along_xi), np.zeros_like(along_eta)
        for part in decomposition.parts:
            column, row = np.isin(i, part.columns), np.isin(j, part.rows)
            for held, owner, count in (
                (np.outer(column[:-1] & column[1:], row), along_xi, holders[0]),
                (np.outer(column, row[:-1] & row[1:]), along_eta, holders[1]),
            ):
                owner[held] = part.number
                count[held] += 1
        return np.where(holders[0] > 1, SHARED_OWNER, along_xi), np.where(holders[1] > 1, SHARED_OWNER, along_eta)

    def polylines(self, along_xi: IntArray, along_eta: IntArray, owner: int) -> list[Array]:
        """The longest runs of edges that belong to ``owner``, each of shape ``(nodes, 2)``."""
        return _runs(self.x, self.y, along_xi == owner) + _runs(self.x.T, self.y.T, (along_eta == owner).T)


def remark_on(step: int) -> str:
    """What a title says where one line in ``step`` is drawn; empty when there are no others."""
    return f"\n(one line in {step} drawn)" if step > 1 else ""


def _runs(x: Array, y: Array, mine: npt.NDArray[np.bool_]) -> list[Array]:
    """Runs of marked edges along the first index."""
    runs = []
    for line in range(x.shape[1]):
        edges = np.concatenate([[False], mine[:, line], [False]])
        changes = np.flatnonzero(edges[1:] != edges[:-1])
        for start, stop in changes.reshape(-1, 2):
            runs.append(np.column_stack([x[start : stop + 1, line], y[start : stop + 1, line]]))
    return runs
