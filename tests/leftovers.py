"""What a run of tests leaves behind: processes that still run at its end, which are reported and ended.

Whoever started the run waits until all its processes have closed their output; one that is left would be waited for.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

# Every process that a run starts inherits this variable, also one that no longer has a parent in the run.
VARIABLE = "TESTS_OF_EQUIMESH"
# Python's own, which ends by itself when the last process that holds it has ended.
_OWN_ENDING = "multiprocessing.resource_tracker"


@dataclass(frozen=True, kw_only=True)
class Process:
    """A process and its command line."""

    pid: int
    command: str


def mark(name: str) -> None:
    """Mark all processes that this one starts from now on."""
    os.environ[VARIABLE] = name


def marked(name: str) -> list[Process]:
    """The running processes with this mark, without this one; none where the system has no ``/proc``."""
    wanted, found = f"{VARIABLE}={name}".encode(), []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile, or belongs to somebody else
            if int(entry.name) != os.getpid() and wanted in (entry / "environ").read_bytes().split(b"\0"):
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                found.append(Process(pid=int(entry.name), command=command))
    return found


def end_marked(name: str) -> list[Process]:
    """Kill all processes with this mark; returns those that should have ended by themselves."""
    left = marked(name)
    for process in left:
        with suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
    return [process for process in left if process.command and _OWN_ENDING not in process.command]


def end_later(seconds: float, end: Callable[[], None]) -> None:
    """Call ``end`` in a thread if this process still runs after so many seconds."""
    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()


def report(left: list[Process]) -> None:
    """Name what was left on standard error, one line for each."""
    for process in left:
        print(f"left by the tests, and ended: {process.pid} {process.command[:200]}", file=sys.__stderr__, flush=True)
