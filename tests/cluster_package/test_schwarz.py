"""A Schwarz iteration on workers: the mesh of one process, its records and bytes, and the loss of a worker."""

from __future__ import annotations

import dask
import numpy as np
import pytest
from distributed import Client

import equimesh as em
from cases import problem
from dask_processes import DaskProcesses
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


def test_several_subdomains_a_worker_and_errors_against_the_single_domain(client: Client) -> None:
    schwarz = em.Schwarz(
        subdomains=(4, 2), transmission=em.Classical(), compare_single_domain=True, tolerance=None, max_iterations=3
    )
    solution = em.solve(CASE, schwarz)
    with on(client, schwarz) as handle:
        assert (handle.count, handle.status) == (3, em.Status.COMPLETED)
        assert np.array_equal(handle.x.compute(scheduler=client), solution.mesh.x)
        errors = [[record.error for record in one] for one in (handle.iterations, solution.iterations)]
        assert errors[0] == pytest.approx(errors[1], abs=1e-14)
        assert not any(isinstance(record, em.Iteration) for record in handle.iterations), "meshes stay where they are"


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


@pytest.mark.everything  # the same loss of a part, which is a thread, in tests/cluster_package/parts/test_schwarz.py
def test_after_a_worker_was_killed_the_iteration_goes_on_from_its_last_iterate(processes: DaskProcesses) -> None:
    processes.have(2)
    slow = em.Schwarz(subdomains=(4, 1), overlap=6, transmission=em.Classical(), fallback=False, tolerance=1e-6)
    seen: list[int] = []

    def kill(record: IterationNumbers) -> None:
        seen.append(record.iteration)
        if record.iteration == 6 and len(seen) == 7:
            processes.kill(next(iter(processes.workers)))

    with on(processes.client, slow, observe=kill) as handle:
        assert (handle.attempts, handle.count) == (2, 1)
        assert handle.resumed >= 5, "it did not begin again"
        assert f"went on from the mesh of iteration {handle.resumed}" in handle.note
        expected = em.solve(CASE, slow)
        assert [record.iteration for record in handle.iterations] == list(range(len(handle.iterations)))
        assert abs(len(handle.iterations) - len(expected.iterations)) <= 3
        x = handle.x.compute(scheduler=processes.client)
        assert abs(x - expected.mesh.x).max() < 1e-5


def test_the_reports_that_the_scheduler_keeps_are_small() -> None:
    kept = dask.config.get("distributed.admin.low-level-log-length")
    assert kept * 2 * np.dtype(float).itemsize * MAX_SHOWN_POINTS < 100e6
