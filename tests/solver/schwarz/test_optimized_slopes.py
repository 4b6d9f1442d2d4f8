"""How metric lengths of edges change with the merged mesh, against difference quotients."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.line_corrections import WholeLineSums
from equimesh.schwarz.optimized import EdgeSlopes
from solver.schwarz.bent import bent


@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
def test_edge_slopes_add_up_to_those_of_the_sums(boundary: em.Boundary) -> None:
    case = problem("paper", 11, 9, boundary=boundary)
    mesh = bent(case, 0.01)
    change = np.sin(3 * mesh.x + mesh.y), np.cos(2 * mesh.y - mesh.x)
    for q, fixed in zip(change, ((0, slice(None)), (slice(None), 0)), strict=True):
        q[fixed] = q[tuple(-1 if part == 0 else part for part in fixed)] = 0.0  # nodes stay on their sides
    along_xi, along_eta = EdgeSlopes(case, mesh).along(change)
    h, found = 1e-6, []
    for step in (h, -h):
        sums = WholeLineSums(case, ({4}, {3}))
        sums.read(em.Mesh(mesh.x + step * change[0], mesh.y + step * change[1]))
        found.append([sums.beyond_point(axis, end, (4, 3)[axis]) for axis in (0, 1) for end in (0, 1)])
    expected = [(ahead - behind) / (2 * h) for ahead, behind in zip(*found, strict=True)]
    slopes = [along_xi[:4].sum(axis=0), along_xi[4:].sum(axis=0), along_eta[:, :3].sum(axis=1)]
    slopes.append(along_eta[:, 3:].sum(axis=1))
    for slope, quotient in zip(slopes, expected, strict=True):
        assert abs(slope).max() > 1e-2
        assert slope == pytest.approx(quotient, abs=1e-6)
