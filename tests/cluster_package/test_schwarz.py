"""A Schwarz iteration on workers: the mesh of one process, its records and bytes, and the loss of a worker."""

from __future__ import annotations

import dask
import numpy as np
import pytest
from distributed import Client

import equimesh as em
from cases import problem
from equimesh.schwarz.records import IterationNumbers
from equimesh_cluster import PartsError, SchwarzHandle, solve
from equimesh_cluster.schwarz import _KEPT, MAX_SHOWN_POINTS

CASE = problem("tanh20", 33, 25)
COUNTED = ("interfaces", "nodes", "sums", "pushes", "corrections")


def on(client: Client, schwarz: em.Schwarz, **options: object) -> SchwarzHandle:
    handle = solve(CASE, client, schwarz=schwarz, **options)
    assert isinstance(handle, SchwarzHandle)
    return handle


def test_the_mesh_stays_on_the_workers_and_is_that_of_one_process(client: Client) -> None:
    schwarz = em.Schwarz(subdomains=(3, 1))
    solution = em.solve(CASE, schwarz)
    seen: list[IterationNumbers] = []
    with on(client, schwarz, observe=seen.append) as handle:
        assert handle.count == 3
        assert abs(handle.x.compute(scheduler=client) - solution.mesh.x).max() < 1e-12
        assert abs(handle.y.compute(scheduler=client) - solution.mesh.y).max() < 1e-12
        assert handle.status is em.Status.CONVERGED
        assert [record.iteration for record in handle.iterations] == list(range(len(solution.iterations)))
        assert [record.traffic for record in handle.iterations] == [record.traffic for record in solution.iterations]
        for record in handle.iterations:
            sent = handle.sent[record.iteration]
            assert sum(sent[kind].bytes for kind in COUNTED if kind in sent) == record.traffic
        assert handle.traffic["kept"].bytes > 0
        assert handle.discretization_error == solution.discretization_error
    assert len(seen) == len(handle.iterations)
    assert all(isinstance(record, em.Iteration) for record in seen), "with meshes, on small grids"
    assert not _KEPT, "nothing is left on the workers, which are threads here"


def test_what_does_not_fit_is_refused_before_the_start(client: Client) -> None:
    with pytest.raises(em.InputError, match="parts = 4: every part needs a subdomain, so take at most 2"):
        on(client, em.Schwarz(subdomains=(2, 1)), parts=4)
    with pytest.raises(em.DecompositionError, match="do not fit 33 columns"):
        on(client, em.Schwarz(subdomains=(40, 1)))


def test_an_iteration_that_does_not_converge_says_so(client: Client) -> None:
    slow = em.Schwarz(subdomains=(3, 1), transmission=em.Classical(), fallback=False, max_iterations=2)
    with pytest.raises(PartsError, match="In iteration 2 the estimated error is") as caught:
        on(client, slow)
    assert caught.value.handle.status is em.Status.NOT_CONVERGED
    caught.value.handle.close()


def test_the_reports_that_the_scheduler_keeps_are_small() -> None:
    kept = dask.config.get("distributed.admin.low-level-log-length")
    assert kept * 2 * np.dtype(float).itemsize * MAX_SHOWN_POINTS < 100e6
