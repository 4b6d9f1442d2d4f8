"""The subdomains of a mesh in blocks."""

from __future__ import annotations

import equimesh as em
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.subdomains import Subdomains
from equimesh.testing.geometries import obstacle

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
SETTINGS = em.Schwarz(overlap=3, local_steps=4, max_exchanges=2)
DOMAIN = obstacle(1500)


def solve() -> LeastErrorSolve:
    monitor = em.LeastError(u=FRONT).on(DOMAIN)
    return LeastErrorSolve(monitor=monitor, domain=DOMAIN, subdomains=Subdomains(settings=SETTINGS))


def test_only_the_finest_mesh_has_subdomains_and_its_records_count_exchanges() -> None:
    subdomains, whole = (
        list(solve().steps()),
        list(LeastErrorSolve(monitor=solve().monitor, domain=DOMAIN).steps()),
    )
    finest = [record for record in subdomains if record.level == record.levels - 1]
    coarse = [record.error for record in subdomains if record.level < record.levels - 1]
    assert coarse == [record.error for record in whole if record.level < record.levels - 1]
    assert [(record.step, record.steps) for record in finest] == [(0, 2), (1, 2), (2, 2)]
    assert finest[0].error > finest[1].error > finest[2].error
