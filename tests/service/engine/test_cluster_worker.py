"""A worker of a cluster in this process: it listens where it is told."""

from __future__ import annotations

import asyncio
import socket
import sys

import pytest
from distributed import Scheduler

from equimesh_service.engine import cluster_worker


def is_open(host: str, port: int) -> bool:
    with socket.socket() as other:
        return other.connect_ex((host, port)) == 0


async def opened(host: str) -> bool:
    """Whether a worker with this ``host`` can also be reached at another address of this machine."""
    async with Scheduler(host="127.0.0.1", port=0, dashboard=False, dashboard_address="127.0.0.1:0") as scheduler:
        member = asyncio.create_task(cluster_worker._take_part(scheduler.address, 1, "one", 0, host))
        while not scheduler.workers:
            assert not member.done(), member.result()
            await asyncio.sleep(0.02)
        (address,) = scheduler.workers
        port = int(address.rpartition(":")[2])
        assert is_open("127.0.0.1", port)
        found = is_open("127.0.0.2", port)
        member.cancel()
        await asyncio.wait([member])
        return found


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a machine has no second address of its own")
def test_a_worker_listens_on_the_named_address_alone() -> None:
    assert asyncio.run(opened(""))
    assert not asyncio.run(opened("127.0.0.1"))
