"""Sums of squared metric lengths along lines: against those of every edge."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.boundary import SideLine, sides
from equimesh.equations.mesh_equations import Cells
from equimesh.schwarz.optimized import line_sums
from equimesh.schwarz.optimized.line_sums import LineSums
from solver.schwarz.bent import bent

SHAPE = (23, 17)


def edge_lengths(case: em.Problem, mesh: em.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The squared metric lengths of all xi-edges and of all eta-edges, those of the sides included."""
    equations = case.equations()
    bottom, top, left, right = (flux.value for flux in Cells(equations.window(equations.vector(mesh))).fluxes)
    along_xi, along_eta = np.zeros((SHAPE[0] - 1, SHAPE[1])), np.zeros((SHAPE[0], SHAPE[1] - 1))
    along_xi[:, 1:-1] = case.grid.d_xi**2 * (top[:, :-1] + bottom[:, 1:])
    along_eta[1:-1] = case.grid.d_eta**2 * (right[:-1] + left[1:])
    for side in sides(case.boundary).values():
        line = SideLine.of(side, case.metric, side.line((mesh.x, mesh.y)[1 - side.axis]))
        side.line((along_xi, along_eta)[1 - side.axis])[:] = line.fluxes
    return along_xi, along_eta


@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
@pytest.mark.parametrize("rows", [64, 5])
@pytest.mark.parametrize("threads", [1, 2])
def test_they_are_the_sums_of_the_edges(
    boundary: em.Boundary, rows: int, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_sums, "MAX_ROWS", rows)
    case = problem("ring", *SHAPE, boundary=boundary)
    mesh = bent(case, 0.01)
    along_xi, along_eta = edge_lengths(case, mesh)
    sums = LineSums(case, ({4, 9}, {6}), threads)
    sums.read(mesh)
    for point in (4, 9):
        assert sums.beyond(0, 0, point) == pytest.approx(along_xi[:point].sum(axis=0))
        assert sums.beyond(0, 1, point) == pytest.approx(along_xi[point:].sum(axis=0))
    assert sums.beyond(1, 0, 6) == pytest.approx(along_eta[:, :6].sum(axis=1))
    assert sums.beyond(1, 1, 6) == pytest.approx(along_eta[:, 6:].sum(axis=1))
    assert sums.edges[0] == pytest.approx(along_eta[[0, -1]])
    assert sums.edges[1] == pytest.approx(along_xi[:, [0, -1]].T)
