"""One attempt of a run."""

from __future__ import annotations

from typing import Any

import pytest
from distributed import Client

from equimesh.numerics.channel import PeerLostError
from equimesh_cluster.run import Attempt, Lost
from equimesh_cluster.workers import WorkerFacts, examine_workers


def nothing(*_: Any) -> None:
    """Nobody looks, nobody cancels."""


@pytest.fixture
def places(client: Client) -> list[WorkerFacts]:
    return examine_workers(client)


def test_the_results_stay_where_they_are(client: Client, places: list[WorkerFacts]) -> None:
    futures = Attempt(client, places, nothing).results(lambda channel: channel.number, lambda *_: (), nothing)
    assert not isinstance(futures, Lost)
    assert [future.result() for future in futures] == [0, 1, 2]


def test_a_part_that_lost_a_peer_is_no_error_of_its_own(client: Client, places: list[WorkerFacts]) -> None:
    def cut_off(channel: Any) -> None:
        if channel.number == 2:
            raise PeerLostError("part 0 cannot be reached")
        channel.receive(2, "never")

    lost = Attempt(client, places, nothing).results(cut_off, lambda *_: (), nothing)
    assert isinstance(lost, Lost)
    assert lost.workers == ()
    assert "part 2 on" in lost.reason
    assert "part 0 cannot be reached" in lost.reason


def test_arguments_may_be_futures(client: Client, places: list[WorkerFacts]) -> None:
    shared = client.submit(lambda: 40, pure=False)
    attempt = Attempt(client, places, nothing)
    futures = attempt.results(lambda channel, one: channel.count + one, lambda *_: (shared,), nothing)
    assert not isinstance(futures, Lost)
    assert [future.result() for future in futures] == [43, 43, 43]


def test_a_worker_that_is_not_there_is_lost(client: Client, places: list[WorkerFacts]) -> None:
    gone = WorkerFacts(
        address="tcp://127.0.0.1:9", identity="", host="h", threads=1, versions={}, limit=0, used=0, free=0
    )

    def waiting(channel: Any) -> None:
        channel.receive(1, "never")

    lost = Attempt(client, [places[0], gone], nothing).results(waiting, lambda *_: (), nothing)
    assert lost == Lost(("tcp://127.0.0.1:9",), "lost: tcp://127.0.0.1:9")
    left = client.run(lambda dask_worker: len(dask_worker.plugins["equimesh-messages"].boxes))
    assert set(left.values()) == {0}
