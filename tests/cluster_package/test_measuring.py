"""Quality and certificate of a mesh on workers: those of the whole mesh."""

from __future__ import annotations

import pytest
from distributed import Client

import equimesh as em
from equimesh_cluster import ClusterError
from equimesh_cluster.handle import measures_of
from meshes_on_workers import PROBLEM, handle_on, parts_on


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


def test_a_closed_handle_measures_nothing(client: Client) -> None:
    handle = handle_on(client, em.solve(PROBLEM), 16)
    handle.close()
    with pytest.raises(ClusterError, match="this handle is closed"):
        handle.quality()


def test_measuring_leaves_nothing_on_the_workers(client: Client) -> None:
    run = parts_on(client, em.solve(PROBLEM), 16)
    before = client.run(lambda dask_worker: sorted(dask_worker.data))
    measures_of(client, run)
    for _ in range(200):
        if client.run(lambda dask_worker: sorted(dask_worker.data)) == before:
            return
    raise AssertionError(client.run(lambda dask_worker: sorted(dask_worker.data)))
