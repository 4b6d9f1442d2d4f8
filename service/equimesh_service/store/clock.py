"""The clock of a database's server, and how far the machine's clock is off."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

from sqlalchemy import Connection, func, select

# How old a reading of the database's clock may be.
_MAX_READING_AGE_SECONDS = 10.0
# A reading that takes longer is repeated: the time may be of its beginning or of its end.
_MAX_READING_SECONDS = 0.5
# How often it is repeated.
_MAX_READINGS = 3
# A machine's clock that is further off is reported. Nothing depends on it but logs, traces and signatures for S3.
MAX_SKEW_SECONDS = 5.0
_NOW = select(func.extract("epoch", func.clock_timestamp()))


class ServerClock:
    """The time of a PostgreSQL server, in seconds since 1970, for all threads.

    The server is asked every ten seconds, by a transaction that begins anyway. In between the time goes on by the
    machine's count of seconds since its start, which does not change with its date. ``begin`` begins a transaction
    that calls :meth:`follow`.
    """

    def __init__(self, begin: Callable[[], AbstractContextManager[Connection]]) -> None:
        self._begin = begin
        self._lock = threading.Lock()  # held during a reading
        self._reading: tuple[float, float] | None = None  # the time of the server, and the count of seconds then

    def __call__(self) -> float:
        """The time now."""
        if self._reading is None:
            with self._begin():
                pass
        assert self._reading is not None
        server, count = self._reading
        return server + count_seconds() - count

    def follow(self, connection: Connection) -> None:
        """Read the server's clock in this transaction, unless the last reading is young."""
        if self._is_young() or not self._lock.acquire(blocking=self._reading is None):
            return  # another thread reads it now
        try:
            for _ in range(_MAX_READINGS):
                if self._is_young():
                    return
                before = count_seconds()
                server = float(connection.execute(_NOW).scalar_one())
                after = count_seconds()
                if after - before <= _MAX_READING_SECONDS:
                    break
            self._reading = (server, (before + after) / 2)
        finally:
            self._lock.release()

    def _is_young(self) -> bool:
        return self._reading is not None and count_seconds() - self._reading[1] < _MAX_READING_AGE_SECONDS


def count_seconds() -> float:
    """Seconds since the start of the machine, also of the time that it was suspended where the system counts that."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


def skew(clock: Callable[[], float]) -> float:
    """The seconds that this machine's clock is ahead of another one; negative when it is behind."""
    before = time.time()
    there = clock()
    return (before + time.time()) / 2 - there


def describe_skew(ahead: float) -> str | None:
    """A sentence about a clock that is off by so many seconds; None where it is right."""
    if abs(ahead) <= MAX_SKEW_SECONDS:
        return None
    word = "ahead of" if ahead > 0 else "behind"
    return f"this machine's clock is {abs(ahead):.0f} s {word} that of the database"
