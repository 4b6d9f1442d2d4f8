"""The kernels of closed lines: means along lines, and rows of copies."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.closed import Closed, padded
from equimesh.meshes.parts import Parts
from equimesh.sweeps.kernels import copy_ends
from equimesh.sweeps.sides import Frame
from equimesh.sweeps.sweep import Sweep, memory_needed

PERIODIC = {(True, False): "x", (False, True): "y", (True, True): "both"}


@pytest.mark.parametrize("closed", PERIODIC)
def test_every_closed_line_keeps_its_mean_from_the_first_sweep(closed: Closed) -> None:
    monitor = em.ArcLength(u=em.Expression("sin(2*pi*x)*cos(2*pi*y)+0.3*sin(2*pi*(x+y))"))
    domain = em.Rectangle(periodic=PERIODIC[closed])  # type: ignore[arg-type]
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=41, n_eta=29), domain=domain)
    start = padded(em.Mesh.uniform(problem.grid), closed)
    x, y = start.x, start.y
    sweep = Sweep(
        problem.metric, problem.boundary, Parts.of(x.shape), np.empty(memory_needed(x.shape)), Frame.around(closed)
    )
    for _ in range(2):
        sweep.correct(x, y)
        x, y = sweep.swap(x, y)
    lines = slice(1, -1)
    if closed[1]:
        assert np.abs(y[lines, lines].mean(axis=1) - 0.5 * 27 / 28).max() < 1e-14
    elif closed[0]:
        assert np.abs(x[lines, lines].mean(axis=0) - 0.5 * 39 / 40).max() < 1e-7
    for axis, q in enumerate((x, y)):
        if closed[axis]:
            moved = np.moveaxis(q, axis, 0)
            assert np.array_equal(moved[-1], moved[1] + 1.0)
            assert np.array_equal(moved[0], moved[-2] - 1.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_outermost_lines_are_copies_of_the_other_side(axis: int) -> None:
    q = np.arange(20.0).reshape(4, 5)
    copy_ends(q, axis, 100.0)
    lines = np.moveaxis(q, axis, 0)
    assert np.array_equal(lines[0], lines[-2] - 100.0)
    assert np.array_equal(lines[-1], lines[1] + 100.0)
