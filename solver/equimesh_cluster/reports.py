"""Reports of parts to the driver while they run: events of Dask under one topic."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from weakref import WeakKeyDictionary

from distributed import Client

from equimesh_cluster.channel import TOPIC

Listener = Callable[[int, Any], None]

_LISTENERS: WeakKeyDictionary[Client, dict[str, Listener]] = WeakKeyDictionary()
"""Who listens to which run. A client has one handler of a topic, and may have several runs."""
_LOCK = threading.Lock()


@contextmanager
def listening(client: Client, run: str, listener: Listener) -> Iterator[None]:
    """Call ``listener(number, value)`` for every report of a part of ``run``, on the thread of the client's loop."""
    listeners = _listeners_of(client)
    listeners[run] = listener
    try:
        yield
    finally:
        del listeners[run]


def _listeners_of(client: Client) -> dict[str, Listener]:
    """The listeners of a client, by run. It subscribes once, for as long as it is there."""
    with _LOCK:
        if client not in _LISTENERS:
            listeners: dict[str, Listener] = {}
            _LISTENERS[client] = listeners
            client.subscribe_topic(TOPIC, lambda event: _hand_over(listeners, event))
        return _LISTENERS[client]


def _hand_over(listeners: dict[str, Listener], event: tuple[float, Any]) -> None:
    """Hand the report of a part to the listener of its run, if that is one of this client's."""
    report = event[1]
    listener = listeners.get(report["run"])
    if listener is not None:
        listener(report["number"], pickle.loads(report["value"]))
