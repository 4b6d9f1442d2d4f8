"""The life of a worker process: it makes the calls that come through its socket, and sends their outcomes."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from equimesh_service.engine.port import pack_error, pack_result
from equimesh_service.errors import MemoryLimitError

LENGTH = struct.Struct("<Q")
"""A message is its length, and that many bytes."""
# The time between two checks of a worker's parent.
_WATCH_SECONDS = 0.2


def run_worker(
    channel: socket.socket,
    memory_limit: int | None,
    prepare: Callable[[], None] | None,
    warm_up: Callable[[], None] | None,
    lifeline: Connection[Any, Any],
) -> None:
    """The life of a worker: it warms up, and makes calls until its socket is closed."""
    # What it was forked with stays: a worker that looked through that would have a copy of its memory.
    gc.freeze()
    gc.enable()
    # A worker is stopped by signals. Python would handle them between two instructions, after a long factorisation.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, args=(lifeline, os.getppid()), daemon=True).start()
    first = _prepared(prepare, warm_up)
    if memory_limit is not None:
        _limit_memory(memory_limit)
    gc.collect()
    gc.freeze()  # what is here stays: to look through it again and again takes as long as a small mesh
    with suppress(OSError):
        _send(channel, first)
        while (message := _receive(channel)) is not None:
            _send(channel, _outcome(message))


def _prepared(prepare: Callable[[], None] | None, warm_up: Callable[[], None] | None) -> bytes:
    """The seconds that the warm-up took, or what it raised, as the first message of a worker."""
    try:
        if prepare is not None:
            prepare()
        began = time.perf_counter()
        if warm_up is not None:
            warm_up()
        return pack_result(time.perf_counter() - began)
    except Exception as error:  # the service learns of it, and replaces this worker
        return pack_error(error)


def _outcome(message: bytearray) -> bytes:
    """The outcome of a call as a message."""
    try:
        function, arguments = pickle.loads(message)
        return pack_result(function(*arguments))
    except MemoryError:
        pass
    except Exception as error:
        return pack_error(error)
    gc.collect()  # nothing refers to the objects of the task now, and the next one needs the memory
    return pack_error(MemoryLimitError("the memory limit was reached"))


def _send(channel: socket.socket, message: bytes) -> None:
    channel.sendall(LENGTH.pack(len(message)))
    channel.sendall(message)


def _receive(channel: socket.socket) -> bytearray | None:
    """The next message; None when the other end is closed."""
    head = _exactly(channel, LENGTH.size)
    return None if head is None else _exactly(channel, LENGTH.unpack(head)[0])


def _exactly(channel: socket.socket, size: int) -> bytearray | None:
    found = bytearray(size)
    left = memoryview(found)
    while left:
        count = channel.recv_into(left)
        if not count:
            return None
        left = left[count:]
    return found


def _die_with_parent(lifeline: Connection[Any, Any], parent: int) -> None:
    # The service may be killed before it stops its workers, and an orphan would compute in vain. So would a worker
    # without the server that it was forked from: the service knows of it through the server alone.
    while not lifeline.poll(_WATCH_SECONDS):
        if os.getppid() != parent:
            break
    os._exit(1)


def _limit_memory(mebibytes: int) -> None:
    if sys.platform != "linux":  # pragma: no cover - elsewhere the system does not enforce this limit
        return
    import resource

    with open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = held + mebibytes * 1024 * 1024
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
