"""Inputs that are sent to workers: small values inside their task, large ones as data of the cluster."""

from __future__ import annotations

from typing import Any

from distributed import Client
from distributed.protocol import pickle

# Pickled values of more bytes are not sent inside a task, which the scheduler reads.
MAX_INLINE_BYTES = 100_000


def sent(client: Client, value: Any) -> Any:
    """The value itself if it is small, else a future of it. The data are gone when all tasks that need them are done.

    Raises whatever cannot be pickled raises.
    """
    if len(pickle.dumps(value)) <= MAX_INLINE_BYTES:
        return value
    return client.scatter(value, hash=False)
