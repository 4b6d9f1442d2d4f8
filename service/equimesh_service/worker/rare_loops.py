"""The loops of rare kinds of problems: compiled by one process of low priority, while the service already works."""

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress

from equimesh_service.errors import EngineError

_log = logging.getLogger(__name__)
# Seconds between two looks whether workers are ready, between two lines of the log, and for the process to end.
_LOOK_SECONDS, _LOG_SECONDS, _STOP_SECONDS = 0.2, 10.0, 10.0
# Added to the niceness of the service: what is requested now comes first.
NICENESS = 10


class LoopCount:
    """How many loops are compiled, and how many there are, as workers count them; both 0 once all are compiled.

    ``ask`` lets a worker count.
    """

    def __init__(self, ask: Callable[[], Future[Mapping[str, int]]]) -> None:
        self._ask = ask
        self._asked: Future[Mapping[str, int]] | None = None
        self._latest: Mapping[str, int] = {"compiled": 0, "of": 0}

    def latest(self) -> Mapping[str, int]:
        """The last count that is known, at once; a worker begins a new one."""
        asked = self._asked
        if asked is None or asked.done():
            with suppress(EngineError, CancelledError):
                self._latest = self._latest if asked is None else asked.result()
            self._asked = self._ask()
        return self._latest

    def now(self) -> Mapping[str, int]:
        """The count of a worker, which is waited for; the last one where none counts, as in a service that stops."""
        with suppress(EngineError, CancelledError):
            self._latest = self._ask().result()
        return self._latest


class RareLoops:
    """Compiles what is left once ``is_ready``, where by ``count`` a loop is kept nowhere yet.

    A problem that needs such a loop earlier compiles it in its worker, or waits for it.
    """

    def __init__(
        self,
        is_ready: Callable[[], bool],
        count: Callable[[], Mapping[str, int]],
        command: tuple[str, ...] = ("-m", __name__),
    ) -> None:
        self._is_ready, self._count, self._command = is_ready, count, command
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="equimesh-loops", daemon=True)
        self.are_compiling = False

    def start(self) -> None:
        """Begin to wait for the workers."""
        self._thread.start()

    def stop(self) -> None:
        """End the process, if it runs; what it has compiled is kept."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join(_STOP_SECONDS)

    def _run(self) -> None:
        while not self._is_ready():
            if self._stopped.wait(_LOOK_SECONDS):
                return
        if not self._count()["of"]:
            return
        self.are_compiling = True
        try:
            self._compile()
        except OSError as error:
            _log.warning("loops of rare kinds are compiled when they are needed: %s", error)
        finally:
            self.are_compiling = False

    def _compile(self) -> None:
        silent = subprocess.DEVNULL
        # It reads its input to see the end of this process.
        with subprocess.Popen([sys.executable, *self._command], stdin=subprocess.PIPE, stdout=silent) as process:
            try:
                while process.poll() is None and not self._stopped.is_set():
                    far = self._count()
                    if far["of"]:
                        _log.info("compiling loops of rare kinds: %(compiled)d of %(of)d are there", far)
                    self._wait(process)
            finally:
                process.kill()
        if process.returncode and not self._stopped.is_set():
            _log.warning("loops of rare kinds are compiled when they are needed: exit status %d", process.returncode)

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        for _ in range(round(_LOG_SECONDS / _LOOK_SECONDS)):
            if process.poll() is not None or self._stopped.wait(_LOOK_SECONDS):
                return


def compile_all() -> None:
    """Warm this process up at low priority; it ends with the process that holds the other end of its input."""
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    threading.Thread(target=_end_with_input, daemon=True).start()
    from equimesh_service.worker import warmth

    warmth.warm_up_once()


def _end_with_input() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    compile_all()
