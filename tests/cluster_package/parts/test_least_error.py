"""Least error in subdomains of several parts: one leads, the others follow, and the mesh is that of one part."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import Region, cells_of_grid, regions_of
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.restricted import RestrictedDescent
from equimesh.least_error.subdomains import Subdomains
from equimesh.numerics.types import Array
from equimesh.testing.geometries import obstacle
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.least_error import PartDescent, PartSubdomains, holders
from solver.bent import objective_on, uniform

GRID = em.Grid(n_xi=25, n_eta=21)
FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
SETTINGS = em.Schwarz(overlap=3, local_steps=4, max_exchanges=2)
DOMAIN = obstacle(1500)


def regions(closed: tuple[bool, bool] = (False, False)) -> tuple[Region, ...]:
    i, j = np.arange(GRID.n_xi - 1) * 3 // GRID.n_xi, np.arange(GRID.n_eta - 1) * 2 // GRID.n_eta
    return regions_of(cells_of_grid(GRID.shape, closed), (i[:, None] * 2 + j).ravel(), 4)


def objective(is_closed: bool) -> Objective:
    if not is_closed:
        return objective_on(GRID)
    weights, cells = Weights(distortion=0.06, smoothness=0.1), cells_of_grid(GRID.shape, (True, False))
    wave = em.Expression("tanh(10*(y - 0.5 - 0.2*sin(2*pi*x)))")
    return Objective(wave, DomainChart(em.Rectangle()), cells, uniform(GRID), weights, Rule())


@pytest.mark.parametrize("parts", [2, 3, 6])
@pytest.mark.parametrize("is_closed", [False, True])
def test_the_mesh_does_not_depend_on_parts(parts: int, is_closed: bool) -> None:
    shared = regions((is_closed, False))

    def mesh_of(descent: RestrictedDescent) -> Array:
        return descent.whole(list(descent.descend(uniform(GRID), 2, 4, 0.0))[-1][0])

    def work(channel: Channel) -> Array:
        return mesh_of(PartDescent(objective(is_closed), shared, 1, channel))

    one = mesh_of(RestrictedDescent(objective(is_closed), shared))
    for other in ThreadChannels(parts).run(work):
        assert np.array_equal(other, one)


@pytest.mark.parametrize("parts", [1, 2, 4, 6, 7])
def test_parts_hold_consecutive_regions_of_about_as_many_cells(parts: int) -> None:
    found = holders(regions(), parts)
    assert found == sorted(found)
    assert set(found) == set(range(min(parts, 6)))


# One part that leads, and others that follow.


def solve_on(channel: Channel | None, smoothness: float = 1.0) -> LeastErrorSolve:
    subdomains = (
        Subdomains(settings=SETTINGS) if channel is None else PartSubdomains(settings=SETTINGS, channel=channel)
    )
    monitor = em.LeastError(u=FRONT, smoothness=smoothness).on(DOMAIN)
    return LeastErrorSolve(monitor=monitor, domain=DOMAIN, subdomains=subdomains)


def points_of(records: list[Descent]) -> Array:
    mesh = records[-1].mesh
    assert isinstance(mesh, em.Mesh)
    return mesh.points


@pytest.mark.parametrize("parts", [2, 3])
def test_parts_that_follow_share_the_work_and_the_mesh_stays_the_same(parts: int) -> None:
    alone = list(solve_on(None, 0.5).steps())

    def work(channel: Channel) -> list[Descent] | int:
        if channel.number == 0:
            records = list(solve_on(channel, 0.5).steps())
            PartSubdomains(settings=SETTINGS, channel=channel).dismiss()
            return records
        followed = 0
        for weights, start, first in PartSubdomains(settings=SETTINGS, channel=channel).orders():
            assert weights[:2] == [em.LeastError.distortion, 0.5]
            solve_on(channel).with_weights(weights).follow(start, first)
            followed += 1
        return followed

    records, *followed = ThreadChannels(parts).run(work)
    assert isinstance(records, list)
    assert np.array_equal(points_of(records), points_of(alone))
    assert [record.error for record in records] == [record.error for record in alone]
    assert followed == [1] * (parts - 1)
