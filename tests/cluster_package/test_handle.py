"""A solution that stays on the workers."""

from __future__ import annotations

import gc
import time
from typing import Any

import numpy as np
import pytest
from distributed import Client

import equimesh as em
from dask_processes import DaskProcesses
from equimesh_cluster import ClusterError, WorkersLostError
from equimesh_cluster.handle import Handle
from meshes_on_workers import PROBLEM, handle_on, parts_on


def data_on(client: Client) -> list[Any]:
    """The keys of all parts on all workers."""
    found = client.run(lambda dask_worker: [key for key in dask_worker.data if "equimesh" in key])
    return [key for keys in found.values() for key in keys]


def require_no_data(client: Client) -> None:
    latest = time.monotonic() + 30.0
    while data_on(client):
        assert time.monotonic() < latest, data_on(client)
        time.sleep(0.02)


def test_a_handle_says_what_a_solution_says(client: Client) -> None:
    solution = em.solve(PROBLEM)
    with handle_on(client, solution, 10, 20) as handle:
        assert handle.status is solution.status
        assert handle.message == solution.message
        assert (handle.grid, handle.count, handle.cuts) == (PROBLEM.grid, 3, (10, 20))
        assert (handle.relaxed, handle.note, handle.remedy) == ((), "", "")
        assert len(handle.records) == len(handle.workers) == 3
        assert handle.traffic["halo"].bytes == 60
        assert repr(handle) == "<Handle: 33 x 17 points, converged, 3 parts>"
        for array, whole in ((handle.x, solution.mesh.x), (handle.y, solution.mesh.y), (handle.u, solution.u)):
            assert array.chunks == ((10, 10, 13), (17,))
            assert np.array_equal(client.compute(array).result(), whole)
        assert len(data_on(client)) == 3


def test_nothing_is_left_of_a_closed_handle(client: Client) -> None:
    handle = handle_on(client, em.solve(PROBLEM), 16)
    kept = handle.x
    handle.close()
    handle.close()
    require_no_data(client)
    with pytest.raises(ClusterError, match="this handle is closed"):
        handle.y  # noqa: B018
    with pytest.raises(Exception, match=r"equimesh-part|cancelled|lost"):
        client.compute(kept).result(timeout=30)


def test_nothing_is_left_of_a_handle_that_nobody_has(client: Client) -> None:
    handle = handle_on(client, em.solve(PROBLEM), 16)
    assert len(data_on(client)) == 2
    del handle
    gc.collect()
    require_no_data(client)


def test_a_client_of_its_own_is_closed_with_a_handle_that_nobody_has(client: Client) -> None:
    own = Client(client.scheduler.address, set_as_default=False)
    handle = Handle(PROBLEM, own, parts_on(own, em.solve(PROBLEM), 16), own_client=True)
    assert handle.count == 2
    del handle
    gc.collect()
    latest = time.monotonic() + 30.0
    while own.status != "closed":
        assert time.monotonic() < latest
        time.sleep(0.02)
    require_no_data(client)


def test_a_worker_that_is_lost_while_it_holds_results_is_an_error_and_nobody_waits(processes: DaskProcesses) -> None:
    processes.have(2)
    client = processes.client
    with handle_on(client, em.solve(PROBLEM), 16) as handle:
        kept = handle.x
        lost = handle.workers[1]
        processes.kill(processes.name_at(lost))
        latest = time.monotonic() + 30.0
        while lost in client.nthreads():
            assert time.monotonic() < latest
        with pytest.raises(WorkersLostError, match="ended, and with them parts of the mesh: solve again") as error:
            handle.y  # noqa: B018
        assert error.value.lost == (lost,)
        with pytest.raises(Exception, match=f"{lost} ended, and with it part 1|lost|cancelled"):
            client.compute(kept).result(timeout=60)
    require_no_data(client)
