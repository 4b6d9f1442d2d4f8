"""The contract of engines. ``check_engine`` runs it against an engine of at least two workers."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

import pytest

from equimesh_service.engine.port import Engine
from equimesh_service.errors import MemoryLimitError, TimeLimitError, WorkerLostError

# Far more than a busy machine needs.
SECONDS = 300.0


def add(first: int, second: int) -> int:
    """A sum."""
    return first + second


def fail(message: str) -> None:
    """An error that the task raises."""
    raise ValueError(message)


def time_out() -> None:
    """A TimeoutError that the task raises, not a time limit."""
    raise TimeoutError("mine")


def own_pid() -> int:
    """The worker's process id."""
    return os.getpid()


def meet(here: str, there: str) -> bool:
    """Whether another task, which waits for this one, runs in parallel."""
    Path(here).touch()
    deadline = time.monotonic() + SECONDS
    while not Path(there).exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    return Path(there).exists()


def spin(marker: str) -> None:
    """Endless work inside one call that no Python signal handler can interrupt."""
    Path(marker).write_text(str(os.getpid()))
    sum(range(10**12))


def sit(marker: str) -> None:
    """A task that does not end, and leaves the processor to others."""
    Path(marker).write_text(str(os.getpid()))
    time.sleep(600.0)


def die() -> None:
    """The worker's death, as by the kernel's memory killer."""
    os.kill(os.getpid(), signal.SIGKILL)


def allocate(mebibytes: int) -> int:
    """Take memory and touch it."""
    return len(bytearray(mebibytes * 1024 * 1024))


def check_engine(engine: Engine, folder: Path, memory_limit: int) -> None:
    """Raise AssertionError where ``engine`` breaks the contract of its port."""
    _check_results(engine)
    _check_parallel(engine, folder)
    _check_cancel(engine, folder)
    _check_time_limit(engine, folder)
    _check_memory_limit(engine, memory_limit)
    _check_lost_worker(engine)
    assert engine.health().ready


def _check_results(engine: Engine) -> None:
    assert engine.health().ready
    assert engine.submit(add, 2, 3).result(SECONDS) == 5
    assert engine.submit(own_pid).result(SECONDS) != os.getpid()
    assert isinstance(engine.submit(fail, "bad").exception(SECONDS), ValueError)
    assert type(engine.submit(time_out).exception(SECONDS)) is TimeoutError


def _check_parallel(engine: Engine, folder: Path) -> None:
    places = [str(folder / name) for name in ("first", "second")]
    tasks = [engine.submit(meet, *order) for order in (places, places[::-1])]
    assert all(task.result(2 * SECONDS) for task in tasks)


def _check_cancel(engine: Engine, folder: Path) -> None:
    task, pid = _begun(engine, spin, folder / "cancel")
    engine.cancel(task)
    assert isinstance(task.exception(SECONDS), CancelledError)
    _expect_end(pid)
    engine.cancel(task)  # a second time does no harm
    busy = [_begun(engine, sit, folder / f"busy{number}")[0] for number in range(engine.health().workers)]
    waiting = engine.submit(add, 1, 1)
    engine.cancel(waiting)
    assert isinstance(waiting.exception(SECONDS), CancelledError)
    for task in busy:
        engine.cancel(task)


def _check_time_limit(engine: Engine, folder: Path) -> None:
    marker, limit = folder / "limit", 0.5
    while not marker.exists():  # on a busy machine the limit may end a task that has not begun
        limit *= 2.0
        assert limit < SECONDS, "a task did not begin"
        assert isinstance(engine.submit(spin, str(marker), time_limit=limit).exception(2.0 * SECONDS), TimeLimitError)
    pid = int(marker.read_text())
    _expect_end(pid)
    assert engine.submit(add, 1, 1, time_limit=SECONDS).result(SECONDS) == 2


def _check_memory_limit(engine: Engine, memory_limit: int) -> None:
    assert engine.submit(allocate, memory_limit // 4).result(SECONDS) > 0
    assert isinstance(engine.submit(allocate, memory_limit * 2).exception(SECONDS), MemoryLimitError)


def _check_lost_worker(engine: Engine) -> None:
    assert isinstance(engine.submit(die).exception(SECONDS), WorkerLostError)
    assert engine.submit(add, 1, 1).result(SECONDS) == 2
    idle = engine.submit(own_pid).result(SECONDS)
    os.kill(idle, signal.SIGKILL)
    time.sleep(0.3)
    deadline = time.monotonic() + SECONDS
    while not engine.health().ready:
        assert time.monotonic() < deadline, "an idle worker was lost, and the engine with it"
        time.sleep(0.05)
    assert engine.submit(add, 1, 1).result(SECONDS) == 2


def _begun(engine: Engine, endless: Callable[[str], None], marker: Path) -> tuple[Future[Any], int]:
    task = engine.submit(endless, str(marker))
    deadline = time.monotonic() + SECONDS
    while not (marker.exists() and marker.read_text()):
        assert time.monotonic() < deadline, "a task did not begin"
        time.sleep(0.01)
    return task, int(marker.read_text())


def _expect_end(pid: int) -> None:
    deadline = time.monotonic() + SECONDS
    while _alive(pid):
        assert time.monotonic() < deadline, "a task that was ended still runs"
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    try:
        # A killed process stays visible until its parent has waited for it.
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:  # no such file, or the process ended while it was read
        return False


def expect_closed(engine: Engine) -> None:
    """A closed engine takes no tasks, and is not ready."""
    assert not engine.health().ready
    with pytest.raises(Exception, match="closed"):
        engine.submit(add, 1, 1)
