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
from equimesh_cluster.handle import Handle, array_of, bytes_of, measures_of, own_x, own_y, summary_of
from equimesh_cluster.messages import Traffic, added
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


# Dask arrays of what stays on the workers.


def test_each_chunk_is_a_view_of_the_rows_of_its_part(client: Client) -> None:
    solution = em.solve(PROBLEM)
    run = parts_on(client, solution, 10, 20)
    array = array_of(run.futures, [10, 10, 13], 17, own_y)
    assert array.chunks == ((10, 10, 13), (17,))
    assert np.array_equal(client.compute(array).result(), solution.mesh.y)
    is_view = client.submit(lambda part: bool(np.shares_memory(own_x(part), part.mesh.x)), run.futures[1], pure=False)
    assert is_view.result()


def test_dask_knows_how_large_a_part_is(client: Client) -> None:
    """Else it would be moved to where it is needed."""
    run = parts_on(client, em.solve(PROBLEM), 16)
    sizes = client.run(lambda dask_worker: {key: ts.nbytes for key, ts in dask_worker.state.tasks.items()})
    found = {key: size for of_worker in sizes.values() for key, size in of_worker.items()}
    expected = client.gather([client.submit(bytes_of, future, pure=False) for future in run.futures])
    assert [found[future.key] for future in run.futures] == expected
    assert expected[0] == 8 * 17 * (17 + 17 + 17 + 17)


# Quality and certificate of a mesh on workers: those of the whole mesh.


def test_a_handle_has_the_quality_and_the_certificate_of_the_whole_mesh(client: Client) -> None:
    solution = em.solve(PROBLEM)
    with handle_on(client, solution, 10, 20) as handle:
        found, whole = handle.quality().summary(), solution.quality.summary()
        for name, expected in whole.items():
            assert found[name] == pytest.approx(expected, rel=8e-13), name
        assert handle.quality() is handle.quality()
        certificate, expected = handle.certificate, solution.certificate
        assert certificate.equation_residual == pytest.approx(expected.equation_residual, rel=1e-6)
        assert certificate.min_jacobian == expected.min_jacobian
        assert certificate.faces.skewness == expected.faces.skewness
        assert (certificate.status, certificate.warnings) == (expected.status, expected.warnings)
    handle.quality()  # it was measured before


def test_measuring_leaves_nothing_on_the_workers(client: Client) -> None:
    run = parts_on(client, em.solve(PROBLEM), 16)
    before = client.run(lambda dask_worker: sorted(dask_worker.data))
    measures_of(client, run)
    for _ in range(200):
        if client.run(lambda dask_worker: sorted(dask_worker.data)) == before:
            return
    raise AssertionError(client.run(lambda dask_worker: sorted(dask_worker.data)))


# What the driver has of a solution in parts.


def test_a_summary_has_everything_but_the_rows(client: Client) -> None:
    solution = em.solve(PROBLEM)
    run = parts_on(client, solution, 10, 20)
    summaries = client.gather([client.submit(summary_of, future, pure=False) for future in run.futures])
    assert [(summary.first, summary.last) for summary in summaries] == [(0, 10), (10, 20), (20, 33)]
    assert {summary.status for summary in summaries} == {solution.status}
    assert {summary.newton_steps for summary in summaries} == {solution.newton_steps}
    assert not hasattr(summaries[0], "mesh")
    assert added(record.traffic for summary in summaries for record in summary.records) == {"halo": Traffic(6, 60)}
