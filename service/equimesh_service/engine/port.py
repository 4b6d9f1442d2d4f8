"""The engine port: where tasks run, how calls travel there, and how a worker process is prepared."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from importlib import import_module
from typing import Any, Protocol, TypeVar

from equimesh_service.settings import Settings
from equimesh_service.telemetry import logs, tracing
from equimesh_service.telemetry.tracer import open_tracer

Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Health:
    """Whether an engine can run tasks, and the number of its workers.

    ``fault`` is the reason why its workers do not start, "" without one.
    """

    ready: bool
    workers: int
    detail: str = ""
    fault: str = ""


class Engine(Protocol):
    """Runs tasks in other processes. Every method returns at once and may be called from any thread."""

    def submit(
        self, function: Callable[..., Result], *arguments: Any, time_limit: float | None = None
    ) -> Future[Result]:
        """Run ``function(*arguments)``, all picklable, in a worker.

        The future has the result or the exception of the function, an
        :class:`~equimesh_service.errors.EngineError`, or is cancelled. ``time_limit`` is in seconds, from the start of
        the task in a worker.
        """
        ...

    def cancel(self, task: Future[Any]) -> None:
        """Give up a task, within a second even when it runs."""
        ...

    def health(self) -> Health:
        """Whether tasks can run now."""
        ...

    def close(self) -> None:
        """Stop all workers; running tasks are given up."""
        ...


@dataclass(frozen=True)
class NamedFunction:
    """A function of workers as ``module:name``: who sends it need not import its module."""

    name: str

    def __call__(self, *arguments: Any) -> Any:
        """The result of the function."""
        module, _, name = self.name.partition(":")
        return getattr(import_module(module), name)(*arguments)


@dataclass(frozen=True)
class PackedCall:
    """A picklable call of a function; calling it makes the call."""

    content: bytes

    @classmethod
    def of(cls, function: Callable[..., Any], *arguments: Any) -> PackedCall:
        """The call of a function with its arguments, all picklable."""
        return cls(pickle.dumps(partial(function, *arguments)))

    def __call__(self) -> Any:
        """The result of the call."""
        return pickle.loads(self.content)()


def pack_outcome(call: PackedCall) -> bytes:
    """The outcome of a call, its result or its exception, to be read by :func:`open_outcome`.

    Raises :class:`MemoryError`, after which the process may not have the memory to describe it.
    """
    try:
        return pack_result(call())
    except MemoryError:
        raise
    except Exception as error:
        return pack_error(error)


def pack_result(result: Any) -> bytes:
    """The outcome of a call that returned."""
    return pickle.dumps((result, None))


def pack_error(error: BaseException) -> bytes:
    """The outcome of a call that raised."""
    try:
        packed = pickle.dumps((None, error))
        pickle.loads(packed)
    except Exception:  # an exception that cannot be sent
        packed = pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return packed


def open_outcome(outcome: bytes | bytearray) -> Any:
    """The result of a packed outcome; raises its exception."""
    result, error = pickle.loads(outcome)
    if error is not None:
        raise error
    return result


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """A picklable record of the preparation; calling it prepares the process."""

    log_level: str
    log_format: str
    trace_endpoint: str

    @classmethod
    def of(cls, settings: Settings) -> Preparation:
        """The preparation that the settings require."""
        return cls(log_level=settings.log_level, log_format=settings.log_format, trace_endpoint=settings.trace_endpoint)

    def __call__(self) -> None:
        """Prepare this process."""
        logs.configure(self.log_level, self.log_format)
        tracing.use(open_tracer(self.trace_endpoint, "worker"))


@dataclass(frozen=True, kw_only=True)
class PoolSettings:
    """The settings of the pools of a service's workers: :class:`~equimesh_service.engine.processes.ProcessEngine`.

    ``check`` returns what a worker cannot reach, "" where it reaches everything. It is called in a process of the pool.
    """

    memory_limit: int | None = None
    preload: tuple[str, ...] = ()
    warm_up: PackedCall | None = None
    prepare: PackedCall | None = None
    check: PackedCall | None = None

    @property
    def name(self) -> str:
        """The name of the pool on each worker: services with the same settings share it."""
        return f"equimesh-{sha256(repr(self).encode()).hexdigest()[:16]}"
