"""Descent on domains in blocks, as on grids: the records, threads, given meshes, and what stays on the boundary."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.nest import coarse_level
from equimesh.meshes.mesh import Mesh
from equimesh.testing.geometries import l_shape, naca0012_o, ring

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")


def solved(domain: Blocks, u: em.Expression = FRONT, start: Mesh | None = None, threads: int = 1) -> list[Descent]:
    return list(LeastErrorSolve(monitor=em.LeastError(u=u).on(domain), domain=domain, threads=threads).steps(start))


def test_records_go_up_the_levels_with_falling_errors() -> None:
    domain = l_shape(1200)
    records = solved(domain)
    assert {record.start for record in records} == {"initial", "rectilinear"}
    assert all(one.level <= other.level for one, other in pairwise(records) if one.start == other.start)
    last = [record for record in records if record.level == records[-1].level]
    assert last[-1].level == last[-1].levels - 1
    assert last[-1].gain is not None
    assert last[-1].gain > 3.0
    assert last[-1].error <= last[0].error
    assert last[-1].points == domain.points
    assert last[-1].grid is None
    assert last[-1].numbers()["points"] == domain.points
    assert "grid" not in last[-1].numbers()


@pytest.mark.parametrize("make", [l_shape, ring, naca0012_o])
def test_nodes_of_the_boundary_stay_on_it_and_corners_stay(make) -> None:  # type: ignore[no-untyped-def]
    domain = make(1000)
    mesh = solved(domain)[-1].mesh
    assert not mesh.is_grid
    assert not mesh.is_folded
    fixed = domain.node_curve == -2
    assert np.array_equal(mesh.points[fixed], domain.mesh.points[fixed])
    for number, curve in enumerate(domain.curves):
        x, y = mesh.points[domain.node_curve == number].T
        if x.size:
            at = curve.evaluate(curve.nearest(x, y))
            assert np.hypot(at[0] - x, at[1] - y).max() < 1e-7
    assert np.abs(mesh.points - domain.mesh.points).max() > 0.01


def test_threads_do_not_change_a_bit() -> None:
    domain = l_shape(4500)
    one, two = (solved(domain, threads=threads)[-1].mesh for threads in (1, 2))
    assert np.array_equal(one.x, two.x)
    assert np.array_equal(one.y, two.y)


def test_a_given_mesh_is_taken_where_it_is_better() -> None:
    domain = l_shape(1200)
    before = solved(domain)[-1]
    assert not before.mesh.is_grid
    records = solved(domain, em.Expression("tanh(12*((x + 0.21)**2 + (y - 0.1)**2 - 0.5))"), before.mesh)
    assert {record.start for record in records} == {"given"}
    assert records[-1].gain is not None
    assert before.gain is not None
    assert records[-1].gain > 0.9 * before.gain


def test_a_function_that_is_interpolated_exactly_keeps_the_initial_mesh() -> None:
    domain = l_shape(600)
    mesh = solved(domain, em.Expression("2*x - y"))[-1].mesh
    assert not mesh.is_grid
    assert mesh.distance(domain.mesh) < 1e-14


def test_comparing_ends_below_the_finest_mesh() -> None:
    domain = l_shape(2500)
    solve = LeastErrorSolve(monitor=em.LeastError(u=FRONT).on(domain), domain=domain)
    steps = solve.coarse(coarse_level(solve.levels))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            reached = end.value
            break
    assert reached.record.level == reached.record.levels - 2
    lifted, initial = solve.lifted_error(reached), solve.initial_error(reached)
    assert lifted < initial
    records = list(solve.steps(coarse=reached))
    assert {record.level for record in records} == {reached.record.level + 1}
    # The descent begins there; it may measure with more Gauss points.
    assert records[0].error == pytest.approx(lifted, rel=0.15)
