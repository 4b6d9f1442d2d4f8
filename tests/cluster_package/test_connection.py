"""The connection to a scheduler."""

from __future__ import annotations

import gc
import socket
import threading
import time

import numpy as np
import pytest
from distributed import Client, Future, LocalCluster

from equimesh import InputError
from equimesh_cluster import ClusterError, NoSchedulerError, RunCancelledError, WorkersLostError, connect, connection
from equimesh_cluster.connection import MAX_INLINE_BYTES, check_client, close_after, leases_of, sent


def test_an_address_without_a_scheduler_is_named_with_what_to_start() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ClusterError, match=f"no scheduler answers at {address} .*start one with `dask scheduler`"):
            connect(address, timeout=0.2)


@pytest.mark.parametrize("faults", [2, 3])
def test_a_greeting_that_comes_with_another_message_is_repeated(monkeypatch: pytest.MonkeyPatch, faults: int) -> None:
    made = list[str]()

    def client(address: str, **_: object) -> str:
        made.append(address)
        assert len(made) > faults
        return "client"

    monkeypatch.setattr(connection, "Client", client)
    if faults == 2:
        assert connect("tcp://here:1") == "client"
    else:
        with pytest.raises(ClusterError, match="no scheduler answers"):
            connect("tcp://here:1")
    assert len(made) == 3


def test_what_is_no_address_is_refused() -> None:
    with pytest.raises(InputError, match="client = 'ftp://nowhere:1' is no address") as error:
        connect("ftp://nowhere:1", timeout=0.2)
    assert error.value.field == "client"


def test_a_connected_client_is_taken_and_others_are_refused(client: Client) -> None:
    assert check_client(client) is client
    with pytest.raises(InputError, match="client = '8786' is no client"):
        check_client(8786)
    with connect(client.scheduler.address) as other:
        check_client(other)
    with pytest.raises(ClusterError, match=r"is not connected \(status closed\)"):
        check_client(other)


def test_a_client_is_closed_when_the_last_of_its_futures_is_gone(client: Client) -> None:
    own = Client(client.scheduler.address, set_as_default=False)
    first, last = own.scatter([1, 2], hash=False)
    close_after(own, [first, last])
    del first
    gc.collect()
    assert own.status == "running"
    assert last.result() == 2
    del last
    gc.collect()
    latest = time.monotonic() + 30.0
    while own.status != "closed":
        assert time.monotonic() < latest
        time.sleep(0.02)


# What is sent to workers.


def test_small_values_are_sent_with_their_task_and_large_ones_are_data_of_the_cluster(client: Client) -> None:
    small = {"n": 3}
    assert sent(client, small) is small
    large = np.arange(MAX_INLINE_BYTES // 8 + 1.0)
    found = sent(client, large)
    assert isinstance(found, Future)
    assert client.submit(lambda values: values.sum(), found, pure=False).result() == large.sum()


# One run at a time on a worker.


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
