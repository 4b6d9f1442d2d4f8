"""The process that workers are forked from, with the modules that all of them need."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from typing import Any

_server_lock = threading.Lock()
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def forking_context(preload: Sequence[str]) -> Any:
    """What starts processes that have imported the modules ``preload``; elsewhere than on Windows by forking."""
    if sys.platform == "win32":  # pragma: no cover
        return multiprocessing.get_context("spawn")
    context = _Forking()
    context.set_forkserver_preload(list(preload))
    _start_server()
    return context


if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess

    class _Forked(ForkServerProcess):
        """A process that is forked from the server, which is restarted when it is gone."""

        def start(self) -> None:
            _start_server()
            with _main_hidden():
                super().start()

    class _Forking(ForkServerContext):
        Process = _Forked


def _start_server() -> None:
    """Start the process that workers are forked from, unless it runs."""
    # One thread in each worker, as there are as many workers as processors. Libraries read this when the server loads
    # them.
    with _server_lock:
        atexit.unregister(_end_server)
        atexit.register(_end_server)
        missing = [name for name in _THREAD_COUNTS if name not in os.environ]
        try:
            for name in missing:
                os.environ[name] = "1"
            with _interrupts_blocked():
                forkserver.ensure_running()
        finally:
            for name in missing:
                del os.environ[name]


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Let the new process inherit that it gets no SIGINT.

    Ctrl-C at a terminal goes to all processes there. The server ignores it only after its imports.
    """
    resource_tracker.ensure_running()  # where the server starts the tracker, that unblocks the signal again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Keep a new process from importing the main module, which it does not need.

    A script that calls :func:`~equimesh_service.running` outside of ``if __name__ == "__main__"`` would otherwise start
    a service in every worker of its service.
    """
    main = vars(sys.modules["__main__"])
    with _server_lock:
        hidden: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
        main.update(dict.fromkeys(hidden))
        try:
            yield
        finally:
            main.update(hidden)


def _end_server() -> None:
    """End the process that workers are forked from. It would otherwise import all of its modules before it ends."""
    with _server_lock:
        server: Any = forkserver._forkserver
        if server._forkserver_pid is not None:
            with suppress(ProcessLookupError):
                os.kill(server._forkserver_pid, signal.SIGKILL)
            server._stop()
