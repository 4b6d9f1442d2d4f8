"""The engine port: where tasks run. An implementation passes ``check_engine`` of the service's tests."""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Health:
    """Whether an engine can run tasks, and the number of its workers.

    ``fault`` says why its workers do not start, "" while they may.
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
