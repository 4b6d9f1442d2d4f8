"""Clients of a Dask cluster: connecting, who may use its workers, and what is sent to them."""

from __future__ import annotations

import asyncio
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from typing import Any

from distributed import Client, Future, Semaphore
from distributed.protocol import pickle

from equimesh.errors import InputError
from equimesh_cluster.errors import NoSchedulerError, WorkersLostError

# Seconds within which a scheduler answers; Dask's own default.
CONNECT_SECONDS = 30.0
# Clients that are made, at most, before their assertion is taken for a scheduler that does not answer.
MAX_GREETINGS = 3
START = "start one with `dask scheduler`, and workers with `dask worker ADDRESS`"
"""The remedy where there is no scheduler."""


def connect(address: str, *, timeout: float | None = None, security: Any = None) -> Client:
    """A client of the scheduler at ``address``, such as ``"tcp://host:8786"``; it becomes Dask's default client.

    ``security`` has Dask's keys and certificates for ``tls://`` addresses, by default those of Dask's settings.
    Raises :class:`~equimesh_cluster.errors.NoSchedulerError` where no scheduler answers within ``timeout`` seconds
    (30), and :class:`~equimesh.errors.InputError` for an address that is none.
    """
    seconds = CONNECT_SECONDS if timeout is None else timeout
    try:
        return _greeted(address, seconds, security)
    except (OSError, TimeoutError, AssertionError) as error:
        raise NoSchedulerError(
            f"no scheduler answers at {address} ({_cause(error)}): check the address, or {START}"
        ) from error
    except (ValueError, TypeError) as error:
        raise InputError(
            f"client = {address!r} is no address of a scheduler ({_cause(error)}): give 'tcp://host:8786'",
            field="client",
        ) from error


def _greeted(address: str, seconds: float, security: Any) -> Client:
    """A client that the scheduler has answered.

    A client of Dask fails by an assertion where the answer comes together with another message. It is made anew then.
    """
    for _ in range(MAX_GREETINGS - 1):
        with suppress(AssertionError):
            return Client(address, timeout=seconds, security=security)
    return Client(address, timeout=seconds, security=security)


def check_client(client: object) -> Client:
    """The client, which is connected and not asynchronous.

    Raises :class:`~equimesh.errors.InputError` for something else, and
    :class:`~equimesh_cluster.errors.NoSchedulerError` for a client that is closed or has lost its scheduler.
    """
    if not isinstance(client, Client):
        raise InputError(
            f"client = {str(client)[:60]!r} is no client of a cluster: give distributed.Client('tcp://host:8786')",
            field="client",
        )
    if client.asynchronous:
        raise InputError("client is asynchronous: give one that was made with asynchronous=False", field="client")
    if client.status != "running":
        raise no_scheduler(client)
    return client


def close_after(client: Client, futures: Sequence[Future[Any]]) -> None:
    """Close ``client`` when no reference to any of ``futures`` is left: they are its last use.

    A separate thread closes it, as the last reference may end in any thread, also in the thread of the client.
    """
    gone = count(1)

    def one_is_gone() -> None:
        if next(gone) == number and client.status not in ("closing", "closed"):
            threading.Thread(target=client.close, daemon=True).start()

    number = len(futures)
    for future in futures:
        weakref.finalize(future, one_is_gone).atexit = False


def no_scheduler(client: Client) -> NoSchedulerError:
    """The error of a client whose scheduler does not answer."""
    address = client.scheduler.address if client.scheduler is not None else "the address of the client"
    return NoSchedulerError(
        f"the scheduler at {address} is not connected (status {client.status}): connect again, or {START}"
    )


def _cause(error: BaseException) -> str:
    """The first line of an error, without a full stop."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".")[:200]


# One run at a time on a worker: two runs that each had half of the workers would wait for each other for ever.
#
# A lease is Dask's own, of a semaphore for each worker. It expires when the client that holds it is gone, which a
# lock of Dask does not. The leases are taken in the order of the addresses, so no two runs wait for each other.

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


# Inputs that are sent to workers: small values inside their task, large ones as data of the cluster.

# Pickled values of more bytes are not sent inside a task, which the scheduler reads.
MAX_INLINE_BYTES = 100_000


def sent(client: Client, value: Any) -> Any:
    """The value itself if it is small, else a future of it. The data are gone when all tasks that need them are done.

    Raises whatever cannot be pickled raises.
    """
    if len(pickle.dumps(value)) <= MAX_INLINE_BYTES:
        return value
    return client.scatter(value, hash=False)
