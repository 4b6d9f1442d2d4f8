"""The embedded engine: worker processes on this machine, each at the end of a socket of its own."""

from __future__ import annotations

import logging
import pickle
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from equimesh_service.engine.fork_server import forking_context
from equimesh_service.engine.port import Health, open_outcome
from equimesh_service.engine.worker_process import LENGTH, run_worker
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError, WorkerLostError

Result = TypeVar("Result")
_log = logging.getLogger(__name__)
# Seconds of a warm-up that is not worth a line in the log: of a worker that was forked warm.
_SHORT_WARM_UP = 0.05
# Workers that die before they have warmed up, until the start counts as failed. It is tried again all the same.
_MAX_BROKEN = 3
# Seconds before workers that could not warm up are replaced.
_PAUSE_SECONDS = 5.0
# Seconds for the threads of an engine to end; they need less than one, unless a process is just started.
_STOP_SECONDS = 30.0
# Bytes that the system holds between the two ends of a socket, where it allows so many.
_BUFFER_BYTES = 1 << 20


@dataclass(eq=False)
class _Task:
    """A call that waits for a worker, or that one has."""

    message: bytes
    future: Future[Any]
    time_limit: float | None


@dataclass(eq=False)
class _Worker:
    """A worker process and our end of its socket, with what is not sent yet and what has come of its next message."""

    process: BaseProcess
    channel: socket.socket
    is_warm: bool = False
    task: _Task | None = None
    deadline: float = float("inf")
    unsent: memoryview = field(default_factory=lambda: memoryview(b""))
    length: bytearray = field(default_factory=lambda: bytearray(LENGTH.size))
    message: bytearray | None = None  # once its length has come
    missing: memoryview = field(init=False)  # of the length, or of the message

    def __post_init__(self) -> None:
        self.missing = memoryview(self.length)

    def send(self, message: bytes | None = None) -> None:
        """Send what the socket takes now of a message, or of what is left of one."""
        if message is not None:
            self.unsent = memoryview(LENGTH.pack(len(message)) + message)
        while self.unsent:
            try:
                self.unsent = self.unsent[self.channel.send(self.unsent) :]
            except BlockingIOError:
                return

    def receive(self) -> bytearray | None:
        """The message that is complete now; None while it is not. Raises EOFError when the worker is gone."""
        try:
            while True:
                while self.missing:
                    count = self.channel.recv_into(self.missing)
                    if not count:
                        raise EOFError
                    self.missing = self.missing[count:]
                if self.message is not None:
                    message, self.message, self.missing = self.message, None, memoryview(self.length)
                    return message
                self.message = bytearray(LENGTH.unpack(self.length)[0])
                self.missing = memoryview(self.message)
        except BlockingIOError:
            return None
        except OSError as error:
            raise EOFError from error

    def end(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.channel.close()


class ProcessEngine:
    """Worker processes, ``workers`` of them; ``memory_limit`` is in MiB for each, on top of what it needs to start.

    ``preload`` names modules that are imported once, before the workers are forked. Each worker first calls
    ``prepare``, which sets up its log, then ``warm_up``. Workers that die or are killed are replaced.

    A task goes to a free worker at once, in the thread that submits it. One thread takes the answers, and kills workers
    at their limits of time; another one starts workers.
    """

    def __init__(
        self,
        workers: int,
        *,
        memory_limit: int | None = None,
        preload: Sequence[str] = (),
        warm_up: Callable[[], None] | None = None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._count = workers
        self._context = forking_context(preload)
        # Workers hold the reading end, which closes when this process ends, however it ends.
        reader, self._lifeline = self._context.Pipe(duplex=False)
        self._start = (memory_limit, prepare, warm_up, reader)
        self._lock = threading.Lock()  # guards the next nine
        self._workers: list[_Worker] = []  # also those that warm up
        self._new: list[_Worker] = []  # those of them whose answers nobody takes yet
        self._free: list[_Worker] = []
        self._waiting: deque[_Task] = deque()
        self._is_warm = False
        self._fault, self._broken = "", 0  # why workers do not start; those that died in their start since one last did
        self._starting = 0
        self._pause_until = 0.0
        self._closed = threading.Event()
        self._missing = threading.Condition(self._lock)
        self._waker, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._next_look = float("inf")  # when the thread looks at limits again, unless it is woken
        self._threads = [
            threading.Thread(target=run, name=f"equimesh-engine-{name}", daemon=True)
            for name, run in (("answers", self._take_answers), ("start", self._keep_workers))
        ]
        for thread in self._threads:
            thread.start()

    def submit(
        self, function: Callable[..., Result], *arguments: Any, time_limit: float | None = None
    ) -> Future[Result]:
        """Run ``function(*arguments)`` in a worker; see :class:`~equimesh_service.engine.port.Engine`."""
        future: Future[Result] = Future()
        future.set_running_or_notify_cancel()
        task = _Task(pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL), future, time_limit)
        with self._lock:
            if self._closed.is_set():
                raise EngineError("the engine is closed")
            self._waiting.append(task)
            self._hand_out()
        return future

    def cancel(self, task: Future[Any]) -> None:
        """Give up the task; a worker that runs it is killed and replaced."""
        with self._lock:
            waiting = next((one for one in self._waiting if one.future is task), None)
            if waiting is not None:
                self._waiting.remove(waiting)
            else:
                worker = next((one for one in self._workers if one.task and one.task.future is task), None)
                if worker is None:
                    return
                self._drop(worker)
        task.set_exception(CancelledError())

    def health(self) -> Health:
        """Ready once a worker has warmed up."""
        with self._lock:
            ready = self._is_warm and not self._closed.is_set()
            fault = "" if ready else self._fault
        detail = fault or ("the engine is closed" if self._closed.is_set() else "workers are starting")
        return Health(ready=ready, workers=self._count, detail="" if ready else detail, fault=fault)

    def wait_until_ready(self, timeout: float) -> bool:
        """Block until a worker has warmed up; False when that takes longer than ``timeout`` seconds."""
        end = time.monotonic() + timeout
        while not self.health().ready:
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

    def close(self) -> None:
        """Stop all workers at once."""
        with self._lock:
            self._closed.set()
            left = [*self._waiting, *(worker.task for worker in self._workers if worker.task is not None)]
            self._waiting.clear()
            workers = [*self._workers]
            for worker in workers:
                self._drop(worker)
            self._wake()
        for task in left:
            task.future.set_exception(CancelledError())
        end = time.monotonic() + _STOP_SECONDS
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        for worker in workers:
            worker.process.join(max(0.0, end - time.monotonic()))
        self._waker.close()

    # With the lock.

    def _hand_out(self) -> None:
        """Give waiting tasks to free workers."""
        while self._waiting and self._free:
            worker, task = self._free.pop(), self._waiting.popleft()
            worker.task = task
            worker.deadline = float("inf") if task.time_limit is None else time.monotonic() + task.time_limit
            with suppress(OSError):  # it is gone, which the other thread is about to see
                worker.send(task.message)
            if worker.unsent or worker.deadline < self._next_look:
                self._wake()

    def _drop(self, worker: _Worker) -> None:
        """Kill a worker, and have another one in its place."""
        if worker not in self._workers:
            return
        self._workers.remove(worker)
        if worker in self._free:
            self._free.remove(worker)
        worker.task = None
        worker.process.kill()
        self._wake()  # the other thread closes the socket, at which it may look
        self._missing.notify()

    def _wake(self) -> None:
        self._next_look = 0.0
        with suppress(OSError):
            self._waker.send(b".")

    # The thread that takes answers.

    def _take_answers(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._woken, selectors.EVENT_READ)
            while not self._closed.is_set():
                try:
                    self._look(selector)
                except Exception:
                    _log.exception("the engine failed to take an answer; it continues")
            with self._lock:  # no worker is left
                self._register(selector)
        self._woken.close()

    def _look(self, selector: selectors.BaseSelector) -> None:
        """Take what has come, and look at the limits."""
        with self._lock:
            self._register(selector)
            self._next_look = min((worker.deadline for worker in self._workers), default=float("inf"))
            seconds = self._next_look - time.monotonic()
        for key, events in selector.select(None if seconds == float("inf") else max(0.0, seconds)):
            if not isinstance(key.data, _Worker):
                with suppress(BlockingIOError):
                    while self._woken.recv(4096):
                        pass
                continue
            if events & selectors.EVENT_WRITE:
                with self._lock, suppress(OSError):
                    key.data.send()
            if events & selectors.EVENT_READ:
                self._read(key.data)
        now = time.monotonic()
        with self._lock:
            late = [(worker, worker.task) for worker in self._workers if worker.task and worker.deadline <= now]
            for worker, _ in late:
                self._drop(worker)
        for _, task in late:
            task.future.set_exception(TimeLimitError("the time limit was reached"))

    def _register(self, selector: selectors.BaseSelector) -> None:
        """Listen to the workers that there are, and to no others."""
        for key in [*selector.get_map().values()]:
            if isinstance(key.data, _Worker) and key.data not in self._workers:
                selector.unregister(key.fileobj)
                key.data.channel.close()
        for worker in self._new:
            if worker in self._workers:
                selector.register(worker.channel, selectors.EVENT_READ, worker)
            else:
                worker.channel.close()
        self._new.clear()
        for worker in self._workers:
            both = selectors.EVENT_READ | selectors.EVENT_WRITE
            wanted = both if worker.unsent else selectors.EVENT_READ
            if worker.channel in selector.get_map() and selector.get_key(worker.channel).events != wanted:
                selector.modify(worker.channel, wanted, worker)

    def _read(self, worker: _Worker) -> None:
        """Take what a worker has sent: that it is warm, or the outcome of its task."""
        with self._lock:
            if worker not in self._workers:
                return
            task, is_gone, message = worker.task, False, None
            try:
                message = worker.receive()
            except EOFError:
                is_gone = True
                self._drop(worker)
                self._note_death(worker)
            if message is not None and task is not None:
                worker.deadline = float("inf")
        if is_gone and task is not None:
            task.future.set_exception(WorkerLostError("the worker died"))
        if message is None:
            return
        if task is None:
            self._begin(worker, message)
            return
        result, error = _opened(message)
        with self._lock:
            if worker.task is not task:
                return  # it was cancelled at this moment
            worker.task = None
            if isinstance(error, MemoryLimitError):
                self._drop(worker)  # what is left of its memory is in pieces
            elif worker in self._workers:
                self._free.append(worker)
                self._hand_out()
        if error is None:
            task.future.set_result(result)
        else:
            task.future.set_exception(error)

    def _begin(self, worker: _Worker, message: bytearray) -> None:
        """Take the first message of a worker: the seconds of its warm-up, or why that failed."""
        try:
            seconds = open_outcome(message)
        except Exception as error:
            _log.exception("the workers cannot warm up")
            with self._lock:
                self._fault = f"the workers cannot warm up: {type(error).__name__}: {error}"
                self._pause_until = time.monotonic() + _PAUSE_SECONDS
                self._drop(worker)
            self._give_up_waiting()
            return
        if seconds > _SHORT_WARM_UP:
            _log.info("a worker warmed up in %.1f s", seconds)
        with self._lock:
            if worker not in self._workers:
                return
            worker.is_warm = self._is_warm = True
            self._fault, self._broken = "", 0
            self._free.append(worker)
            self._hand_out()

    def _note_death(self, worker: _Worker) -> None:
        """Note that a worker died by itself; with the lock."""
        if not any(other.is_warm for other in self._workers):
            self._is_warm = False
        if worker.is_warm:
            _log.warning("a worker died, and is replaced")
            return
        self._broken += 1
        if self._broken >= _MAX_BROKEN:
            self._fault = "the workers die when they start; perhaps the system lacks memory"
            self._pause_until = time.monotonic() + _PAUSE_SECONDS

    def _give_up_waiting(self) -> None:
        """End the tasks that wait for workers which do not start."""
        with self._lock:
            left = [] if self._is_warm else [*self._waiting]
            if left:
                self._waiting.clear()
            fault = self._fault
        for task in left:
            task.future.set_exception(WorkerLostError(f"there are no workers: {fault}"))

    # The thread that starts workers.

    def _keep_workers(self) -> None:
        while not self._closed.is_set():
            with self._lock:
                while len(self._workers) >= self._count and not self._closed.is_set():
                    self._missing.wait()
                pause = self._pause_until - time.monotonic()
            if self._fault:
                self._give_up_waiting()
            if pause > 0 and self._closed.wait(pause):
                return
            if self._closed.is_set():
                return
            try:
                self._add_worker()
            except Exception:  # for instance when no process can be started
                _log.exception("no worker can be started; it will be tried again")
                with self._lock:
                    self._fault = self._fault or "no worker process can be started"
                    self._pause_until = time.monotonic() + _PAUSE_SECONDS

    def _add_worker(self) -> None:
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        process = self._context.Process(target=run_worker, args=(theirs, *self._start), daemon=True)
        try:
            process.start()
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        ours.setblocking(False)
        worker = _Worker(process, ours)
        with self._lock:
            if self._closed.is_set():
                worker.end()
                return
            self._workers.append(worker)
            self._new.append(worker)
            self._wake()


def _opened(message: bytearray) -> tuple[Any, Exception | None]:
    """The result and the exception in a message of a worker."""
    try:
        return open_outcome(message), None
    except Exception as error:
        return None, error
