"""The writer: what workers have finished is committed in groups, by one thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Generic, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import EngineError
from equimesh_service.files.port import Publish, Removed
from equimesh_service.store.blobs import insert_blob
from equimesh_service.store.database import Database
from equimesh_service.store.rows import Claim, FinishedMesh, NewStep, keep_file
from equimesh_service.store.store import Store

Result = TypeVar("Result")
# The largest number of waiting changes, which are committed together. The caller with one more waits for a place.
MAX_WAITING = 64


@dataclass(frozen=True)
class _Change(Generic[Result]):
    """A change of the store, and the future of what it returns."""

    make: Callable[[], Result]
    future: Future[Result] = field(default_factory=Future)

    def attempt(self) -> Callable[[], None]:
        """Make the change; returns a function that sets the future. Raises where the database itself may not work."""
        try:
            return partial(self.future.set_result, self.make())
        except SQLAlchemyError:
            raise
        except Exception as error:
            return partial(self.future.set_exception, error)

    def make_alone(self) -> None:
        """Make the change in a transaction of its own, and tell the outcome."""
        try:
            result = self.make()
        except Exception as error:
            self.future.set_exception(error)
        else:
            self.future.set_result(result)


class Writer:
    """A thread that commits all changes that wait in one transaction, with one sync of the disk.

    A change is a part of the transaction: if it raises, it alone is undone. Where the transaction fails, each change is
    made once more in one of its own, so that each has its own result or error. The thread begins with the first change.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._waiting: queue.Queue[_Change[Any] | None] = queue.Queue(MAX_WAITING)
        self._lock = threading.Lock()  # guards the next two
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def commit(self, make: Callable[[], Result]) -> Future[Result]:
        """The future of what ``make`` returns or raises, known when its change of the store is committed.

        Raises :class:`~equimesh_service.errors.EngineError` after :meth:`close`.
        """
        change = _Change(make)
        with self._lock:
            if self._is_closed:
                raise EngineError("the service is stopping")
            if self._thread is None:
                self._thread = threading.Thread(target=self._loop, name="equimesh-writer", daemon=True)
                self._thread.start()
            self._waiting.put(change)
        return change.future

    def close(self) -> None:
        """Commit what waits, and end the thread."""
        with self._lock:
            thread, self._thread, self._is_closed = self._thread, None, True
            if thread is not None:
                self._waiting.put(None)
        if thread is not None:
            thread.join()

    def _loop(self) -> None:
        while (first := self._waiting.get()) is not None:
            group, last = [first], False
            while not last and len(group) < MAX_WAITING and not self._waiting.empty():
                more = self._waiting.get()
                if more is None:
                    last = True
                else:
                    group.append(more)
            self._commit(group)
            if last:
                return

    def _commit(self, group: list[_Change[Any]]) -> None:
        if len(group) == 1:
            group[0].make_alone()
            return
        try:
            with self._database.write():
                outcomes = [change.attempt() for change in group]
        except Exception:
            for change in group:
                change.make_alone()
            return
        for tell in outcomes:
            tell()


def with_contents(step: NewStep, store: Store, discard: Callable[[str], None]) -> NewStep:
    """A step that came from a worker, whose files are published from their bytes."""
    files = step.contents
    fields = {} if step.fields is None else {step.fields.sha256: files[step.fields.sha256]}
    functions = [(row, _inserting(store, {row.sha256: files[row.sha256]})) for row, _ in step.functions]
    return replace(step, publish=_inserting(store, fields), functions=functions, discard=discard)


def store_finished(
    store: Store, claim: Claim, finished: FinishedMesh, discard: Callable[[str], None] = keep_file
) -> str | None:
    """Put a finished mesh into the store with the bytes of its files, as one change.

    Returns its id, None when the claim is no longer valid, and for a new mesh as
    :meth:`~equimesh_service.store.meshes.MeshesStore.add_finished`. ``discard`` is called with the files of meshes that
    a step replaces, which no row names any more.
    """
    entry, outcome = finished.entry, replace(finished.outcome, publish=_inserting(store, finished.contents))
    if entry is None:
        return claim.mesh_id if store.queue.finish(claim, outcome) else None
    if entry.step is not None:
        entry = replace(entry, step=with_contents(entry.step, store, discard))
    sent = {} if entry.samples is None else {entry.samples.row.sha256: entry.samples.archive}
    return store.meshes.add_finished(entry, outcome, seconds=finished.seconds, publish_samples=_inserting(store, sent))


def _inserting(store: Store, contents: Mapping[str, bytes]) -> Publish:
    """Inserts small files, by their SHA-256, as rows."""

    def publish(_: Removed) -> None:
        for sha256, content in contents.items():
            insert_blob(store.database, sha256, content)

    return publish
