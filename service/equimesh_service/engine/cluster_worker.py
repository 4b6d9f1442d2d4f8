"""A worker of a cluster as a process: it joins, takes jobs, and joins again when the scheduler was lost."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from contextlib import suppress
from typing import Any

from distributed import Worker

_log = logging.getLogger(__name__)
# The time between two attempts to join a cluster.
_JOIN_AGAIN_SECONDS = 1.0
# The longest time that a worker has to leave the cluster.
_MAX_LEAVE_SECONDS = 5.0


def default_name() -> str:
    """A name that differs for every worker: the machine and the process."""
    return f"{socket.gethostname()}-{os.getpid()}"


def run_worker(scheduler: str, slots: int, name: str, health_port: int = 0, host: str = "") -> None:
    """Work for the cluster with this ``scheduler``, ``slots`` jobs at the same time, until SIGINT or SIGTERM.

    ``GET /health`` at ``health_port`` answers all the while; 0 takes a free port. It listens on all addresses of this
    machine, or on ``host`` alone.
    """
    # The worker reports itself what becomes of its connection.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    asyncio.run(_work(scheduler, slots, name, health_port, host))


async def _work(scheduler: str, slots: int, name: str, health_port: int, host: str) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    stopped = asyncio.create_task(stop.wait())
    _log.info("worker %s looks for the scheduler at %s", name, scheduler)
    while not stop.is_set():
        member = asyncio.create_task(_take_part(scheduler, slots, name, health_port, host))
        await asyncio.wait([member, stopped], return_when=asyncio.FIRST_COMPLETED)
        if not member.done():
            member.cancel()
        try:
            await member
        except asyncio.CancelledError:
            break
        except Exception as error:  # such as a name that another worker has, or another release of Dask
            _log.warning("worker %s cannot join the cluster at %s: %s", name, scheduler, error)
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), _JOIN_AGAIN_SECONDS)
    stopped.cancel()
    _log.info("worker %s ends", name)


async def _take_part(scheduler: str, slots: int, name: str, health_port: int, host: str) -> None:
    """Be a worker of the cluster until the connection to the scheduler is lost."""
    health = f"{host}:{health_port}"
    worker: Any = Worker(
        scheduler, nthreads=slots, name=name, host=host or None, dashboard=False, dashboard_address=health
    )
    try:
        await worker  # waits for the scheduler
        _log.info("worker %s joins the cluster at %s with %d processes", name, scheduler, slots)
        await worker.finished()
        _log.warning("worker %s has lost the scheduler at %s", name, scheduler)
    finally:
        with suppress(Exception):
            await worker.close(timeout=_MAX_LEAVE_SECONDS, executor_wait=False, nanny=False)
