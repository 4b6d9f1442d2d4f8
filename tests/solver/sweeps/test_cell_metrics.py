"""The metric of cells: a stencil of u for the arc length, values at the centres for all other monitors."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.sweeps.line_sums import MARGIN, cell_memory, cell_metrics
from solver.sweeps.windows import disturbed


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_rows_do_not_depend_on_the_other_rows(kind: type, domain: em.Domain) -> None:
    """To the last bit, and with u given at the nodes or not."""
    monitor = kind(u=em.Expression("tanh(5*(x - y))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=7), domain=domain)
    mesh = disturbed(case, 1e-3)
    whole, some = np.empty((3, 8, 6)), np.empty((3, 3, 6))
    cell_metrics(case.metric, mesh.x, mesh.y, whole)
    rows = slice(2, 6)
    cell_metrics(case.metric, mesh.x[rows], mesh.y[rows], some, case.metric.u(mesh.x[rows], mesh.y[rows]))
    assert np.array_equal(some, whole[:, 2:5])
    assert (whole[0] * whole[2] - whole[1] ** 2 > 0.0).all()


def test_a_linear_u_has_the_metric_of_the_formula() -> None:
    case = em.Problem(
        monitor=em.ArcLength(u=em.Expression("2*x + y"), a=0.8, b=0.5, scaled=False), grid=em.Grid(n_xi=6, n_eta=5)
    )
    mesh, found = disturbed(case), np.empty((3, 5, 4))
    cell_metrics(case.metric, mesh.x, mesh.y, found)
    k = 0.8**2 / (1.0 + 0.5 * 5.0)
    for entry, expected in zip(found, (1.0 + 4.0 * k, 2.0 * k, 1.0 + k), strict=True):
        assert entry == pytest.approx(np.full((5, 4), expected), rel=1e-12)


def test_the_memory_of_cells_lies_apart_from_all_other() -> None:
    cells = cell_memory(3, 9)
    whole = cells.base
    while whole.base is not None:
        whole = whole.base
    before = (cells.ctypes.data - whole.ctypes.data) // 8
    after = whole.size - before - cells.size
    assert cells.shape == (3, 3, 8)
    assert cells.flags.c_contiguous
    assert min(before, after) >= MARGIN + 2 * 8
