"""The subdomains of a mesh in blocks: one part that leads, and others that follow, on any number of parts."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.subdomains import Subdomains
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.numerics.types import Array
from equimesh.testing.geometries import obstacle

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
SETTINGS = em.Schwarz(overlap=3, local_steps=4, max_exchanges=2)
DOMAIN = obstacle(1500)


def solve_on(channel: Channel | None, smoothness: float = 1.0) -> LeastErrorSolve:
    subdomains = Subdomains(settings=SETTINGS) if channel is None else Subdomains(settings=SETTINGS, channel=channel)
    monitor = em.LeastError(u=FRONT, smoothness=smoothness).on(DOMAIN)
    return LeastErrorSolve(monitor=monitor, domain=DOMAIN, subdomains=subdomains)


def points_of(records: list[Descent]) -> Array:
    mesh = records[-1].mesh
    assert isinstance(mesh, em.QuadMesh)
    return mesh.points


@pytest.mark.parametrize("parts", [2, 3])
def test_parts_that_follow_share_the_work_and_the_mesh_stays_the_same(parts: int) -> None:
    alone = list(solve_on(None, 0.5).steps())

    def work(channel: Channel) -> list[Descent] | int:
        if channel.number == 0:
            records = list(solve_on(channel, 0.5).steps())
            Subdomains(settings=SETTINGS, channel=channel).dismiss()
            return records
        followed = 0
        for weights, start, first in Subdomains(settings=SETTINGS, channel=channel).orders():
            assert weights[:2] == [em.LeastError.distortion, 0.5]
            solve_on(channel).with_weights(weights).follow(start, first)
            followed += 1
        return followed

    records, *followed = ThreadChannels(parts).run(work)
    assert isinstance(records, list)
    assert np.array_equal(points_of(records), points_of(alone))
    assert [record.error for record in records] == [record.error for record in alone]
    assert followed == [1] * (parts - 1)


def test_only_the_finest_mesh_has_subdomains_and_its_records_count_exchanges() -> None:
    subdomains, whole = (
        list(solve_on(None).steps()),
        list(LeastErrorSolve(monitor=solve_on(None).monitor, domain=DOMAIN).steps()),
    )
    finest = [record for record in subdomains if record.level == record.levels - 1]
    coarse = [record.error for record in subdomains if record.level < record.levels - 1]
    assert coarse == [record.error for record in whole if record.level < record.levels - 1]
    assert [(record.step, record.steps) for record in finest] == [(0, 2), (1, 2), (2, 2)]
    assert finest[0].error > finest[1].error > finest[2].error
