"""One run at a time on a worker: two runs that each had half of the workers would wait for each other for ever.

A lease is Dask's own, of a semaphore for each worker. It expires when the client that holds it is gone, which a lock of
Dask does not. The leases are taken in the order of the addresses, so no two runs wait for each other.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from distributed import Client, Semaphore

from equimesh_cluster.connection import no_scheduler
from equimesh_cluster.errors import WorkersLostError

# Seconds between two looks at whether the run was cancelled, and whether the worker that it waits for still exists.
LOOK_SECONDS = 0.5


@contextmanager
def leases_of(client: Client, addresses: Sequence[str], check: Callable[[], None]) -> Iterator[None]:
    """The right to run on the workers at ``addresses``, given back at the end.

    ``check`` is called while it waits for another run; what it raises ends the waiting. Raises
    :class:`~equimesh_cluster.errors.WorkersLostError` where a worker is lost meanwhile, and
    :class:`~equimesh_cluster.errors.NoSchedulerError` where the scheduler is.
    """
    with ExitStack() as held:
        try:
            for address in sorted(set(addresses)):
                _take(client, address, check, held)
        except (OSError, asyncio.CancelledError, AttributeError) as error:  # a client that has closed has no scheduler
            if isinstance(error, AttributeError) and client.status == "running":
                raise
            raise no_scheduler(client) from error
        yield


def _take(client: Client, address: str, check: Callable[[], None], held: ExitStack) -> None:
    """Wait for the lease of one worker; ``held`` gives it back."""
    lease = _semaphore(client, address)
    held.callback(_stop_refreshing, client, lease)
    while not lease.acquire(timeout=LOOK_SECONDS):
        check()
        if not client.nthreads(workers=[address]):
            raise WorkersLostError(f"the worker {address} was lost", lost=(address,))
    held.callback(_give_back, client, lease)


def _stop_refreshing(client: Client, lease: Semaphore) -> None:
    """Let the event loop of the client forget a lease."""
    if client.loop is not None:
        client.loop.add_callback(lease.refresh_callback.stop)


def _give_back(client: Client, lease: Semaphore) -> None:
    """Release a lease, unless the client has gone: then it expires."""
    if client.status == "running":
        lease.release()


def _semaphore(client: Client, address: str) -> Semaphore:
    """The semaphore of a worker, with one lease."""
    return Semaphore(max_leases=1, name=f"equimesh-{address}", scheduler_rpc=client.scheduler, loop=client.loop)
