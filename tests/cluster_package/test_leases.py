"""One run at a time on a worker."""

from __future__ import annotations

import threading

import pytest
from distributed import Client, LocalCluster

from equimesh_cluster import NoSchedulerError, RunCancelledError, WorkersLostError
from equimesh_cluster.connection import leases_of


def nothing() -> None:
    """Nobody has cancelled."""


def refuse() -> None:
    raise RunCancelledError("enough")


def test_a_worker_is_leased_once_at_a_time(client: Client) -> None:
    a, b, c = client.nthreads()
    with leases_of(client, [a, b, a], nothing):
        with leases_of(client, [c], nothing):
            pass
        with pytest.raises(RunCancelledError), leases_of(client, [c, b], refuse):
            pass
        with leases_of(client, [c], refuse):  # what was taken before the refusal is free again
            pass
    with leases_of(client, [a, b, c], refuse):
        pass


def test_who_waits_for_a_lease_gets_it_when_it_is_free(client: Client) -> None:
    a, order = next(iter(client.nthreads())), []

    def wait() -> None:
        with leases_of(client, [a], nothing):
            order.append("second")

    waiting = threading.Thread(target=wait)
    with leases_of(client, [a], nothing):
        waiting.start()
        order.append("first")
    waiting.join(timeout=60)
    assert order == ["first", "second"]


def test_the_lease_of_a_client_that_is_gone_expires(client: Client) -> None:
    a = next(iter(client.nthreads()))
    gone = Client(client.scheduler.address, set_as_default=False)
    held = leases_of(gone, [a], nothing)
    held.__enter__()
    with pytest.raises(RunCancelledError), leases_of(client, [a], refuse):
        pass
    gone.close()
    with leases_of(client, [a], nothing):
        pass


def test_a_worker_that_is_lost_is_not_waited_for(client: Client) -> None:
    with (
        leases_of(client, ["tcp://127.0.0.1:9"], nothing),
        pytest.raises(WorkersLostError, match=r"127\.0\.0\.1:9 was lost"),
        leases_of(client, ["tcp://127.0.0.1:9"], nothing),
    ):
        pass


def test_a_scheduler_that_is_lost_meanwhile_is_said() -> None:
    options = {"dashboard_address": ":0", "processes": False, "threads_per_worker": 1, "memory_limit": 0}
    with (
        LocalCluster(n_workers=1, **options) as cluster,
        Client(cluster, set_as_default=False, timeout=1) as one,
        Client(cluster, set_as_default=False, timeout=1) as other,
    ):
        (a,) = one.nthreads()
        with (
            leases_of(other, [a], nothing),
            pytest.raises(NoSchedulerError, match="is not connected"),
            leases_of(one, [a], cluster.close),
        ):
            pass
