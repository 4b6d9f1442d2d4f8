"""Dask arrays of what stays on the workers."""

from __future__ import annotations

import numpy as np
from distributed import Client

import equimesh as em
from equimesh_cluster.handle import array_of, bytes_of, own_x, own_y
from meshes_on_workers import PROBLEM, parts_on


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
