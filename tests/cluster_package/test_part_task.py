"""The task of one part."""

from __future__ import annotations

from typing import Any

import pytest
from distributed import Client

from equimesh.numerics.channel import PeerLostError
from equimesh_cluster.channel import Seat, run_part
from equimesh_cluster.workers import examine_workers


def number(channel: Any, more: int) -> int:
    return channel.number + more


def submitted(client: Client, identity: str, address: str) -> Any:
    seat = Seat(run="run", number=0, addresses=(address,), identity=identity, key=f"key-{identity}")
    return client.submit(run_part, seat, number, (5,), key=seat.key, workers=[address])


def test_it_returns_what_its_function_returns_and_removes_its_box(client: Client) -> None:
    worker = examine_workers(client)[0]
    assert submitted(client, worker.identity, worker.address).result() == 5
    assert client.run(lambda dask_worker: len(dask_worker.plugins["equimesh-messages"].boxes)) == dict.fromkeys(
        client.nthreads(), 0
    )


def test_a_worker_that_was_started_again_does_not_join_the_run(client: Client) -> None:
    worker = examine_workers(client)[0]
    with pytest.raises(PeerLostError, match="ended, and with it part 0"):
        submitted(client, "another process", worker.address).result()
