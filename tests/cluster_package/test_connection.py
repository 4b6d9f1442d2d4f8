"""The connection to a scheduler."""

from __future__ import annotations

import gc
import socket
import time

import pytest
from distributed import Client

from equimesh import InputError
from equimesh_cluster import ClusterError, connect, connection
from equimesh_cluster.connection import check_client, close_after


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
