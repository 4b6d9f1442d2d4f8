"""Sums of squared metric lengths along pieces of lines: against those of every edge."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import Cells
from equimesh.equations.problem import SideLine, sides
from equimesh.schwarz import line_corrections as module
from equimesh.schwarz.line_corrections import Segments
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
@pytest.mark.parametrize("threads", [1, 2])
def test_they_are_the_sums_of_the_edges(boundary: em.Boundary, threads: int) -> None:
    case = problem("ring", *SHAPE, boundary=boundary)
    mesh = bent(case, 0.01)
    along_xi, along_eta = edge_lengths(case, mesh)
    cuts = np.array([0, 4, 9, 22]), np.array([0, 6, 16])
    found = Segments(case, SHAPE, cuts, threads)
    found.read(mesh)
    assert found.along[0] == pytest.approx(np.add.reduceat(along_xi, cuts[0][:-1], axis=0))
    assert found.along[1] == pytest.approx(np.add.reduceat(along_eta, cuts[1][:-1], axis=1).T)
    assert found.edges[0] == pytest.approx(along_eta[[0, -1]])
    assert found.edges[1] == pytest.approx(along_xi[:, [0, -1]].T)


def test_a_window_has_the_same_sums_to_the_last_bit() -> None:
    """Of the lines between its first and last one; on sides that are not physical there are none."""
    case = problem("ring", *SHAPE)
    mesh = bent(case, 0.01)
    whole = Segments(case, SHAPE, (np.array([0, 4, 9, 22]), np.array([0, 6, 16])))
    whole.read(mesh)
    frame = module.Frame(physical=((False, False), (True, False)))
    window = Segments(case, (8, 12), (np.array([1, 6]), np.array([0, 6])), frame=frame)
    window.read(em.Mesh(mesh.x[3:11, :12].copy(), mesh.y[3:11, :12].copy()))
    assert np.array_equal(window.along[0][0, :-1], whole.along[0][1, :11])
    assert np.array_equal(window.along[1][0, 1:6], whole.along[1][0, 4:9])
    assert not window.edges[0].any()
    assert not window.along[0][:, -1].any()
