"""Retention: the removal of expired meshes and samples, and of files that a crash left unnamed."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from equimesh_service.files.port import Files
from equimesh_service.problems.storage import storage_problem
from equimesh_service.store.store import Store

_log = logging.getLogger(__name__)
_DAY_SECONDS = 86_400.0
_HOUR_SECONDS = 3600.0
# Younger files may belong to a mesh that is being finished.
_MIN_ORPHAN_SECONDS = _HOUR_SECONDS
# The most files that are looked up in one query.
_MAX_LOOKED_UP = 500
# The most files that are removed at once.
_MAX_REMOVED = 20
# The ids of removed meshes are remembered for this many times the days of retention.
_REMEMBERED_TIMES = 10
# They are remembered for at least this time.
_MIN_REMEMBERED_DAYS = 90


@dataclass(frozen=True, kw_only=True)
class Swept:
    """The numbers of meshes, samples and unnamed files that one sweep has removed."""

    meshes: int
    samples: int
    orphans: int


class Retention:
    """A thread that sweeps at the start and then every hour.

    Finished meshes, and samples that no mesh uses, are kept for ``days``; 0 keeps them forever. Any number of services
    may sweep the same store.
    """

    def __init__(self, store: Store, files: Files, days: float) -> None:
        self._store = store
        self._files = files
        self._days = days
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="equimesh-retention", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread, also in the middle of a sweep, which the next one continues."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def sweep(self) -> Swept:
        """Remove all expired meshes and samples, and unnamed files."""
        kept, store, remover = self._days * _DAY_SECONDS, self._store.retention, _Remover(self._files)
        meshes = samples = 0
        try:
            if self._days > 0:
                meshes = self._all(lambda: store.retire_meshes(kept, remover.remove))
                samples = self._all(lambda: store.retire_samples(kept, remover.remove))
            store.forget(max(_REMEMBERED_TIMES * kept, _MIN_REMEMBERED_DAYS * _DAY_SECONDS))
            remover.attempt("unfinished", self._files.tidy)
            return Swept(meshes=meshes, samples=samples, orphans=self._remove_orphans(remover))
        finally:
            remover.report()

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                swept = self.sweep()
                if swept != Swept(meshes=0, samples=0, orphans=0):
                    _log.info(
                        "removed: %d expired meshes, %d expired samples, %d unnamed files",
                        swept.meshes,
                        swept.samples,
                        swept.orphans,
                    )
            except Exception as error:
                if storage_problem(error) is None:  # which says itself what it is
                    _log.exception("the sweep failed; the next one is in an hour")
            self._stopping.wait(_HOUR_SECONDS)

    def _all(self, some: Callable[[], int]) -> int:
        removed = 0
        while not self._stopping.is_set() and (number := some()):
            removed += number
        return removed

    def _remove_orphans(self, remover: _Remover) -> int:
        before = remover.removed
        old = (file.sha256 for file in self._files.listing() if file.age > _MIN_ORPHAN_SECONDS)
        while not self._stopping.is_set() and (some := list(islice(old, _MAX_LOOKED_UP))):
            left = iter(self._store.retention.find_unnamed(some) - remover.failed.keys())
            while not self._stopping.is_set() and (few := list(islice(left, _MAX_REMOVED))):
                self._store.retention.remove_unnamed(few, remover.remove)
        return remover.removed - before


class _Remover:
    """Removes the files of one sweep; those that cannot be removed are left to the next sweep, and do not stop it."""

    def __init__(self, files: Files) -> None:
        self._files = files
        self.removed = 0
        self.failed: dict[str, OSError] = {}

    def remove(self, sha256: str) -> None:
        """Remove a file; raises :class:`OSError` only where the storage as a whole does not work."""
        self.removed += self.attempt(sha256, lambda: self._files.remove(sha256))

    def attempt(self, name: str, act: Callable[[], None]) -> bool:
        """Call ``act``; returns whether it succeeded, raises :class:`OSError` as :meth:`remove`."""
        try:
            act()
        except OSError as error:
            self._files.check()  # raises when the storage as a whole has failed
            self.failed[name] = error
            return False
        return True

    def report(self) -> None:
        """Log the files that were left."""
        if self.failed:
            name, error = next(iter(self.failed.items()))
            _log.warning(
                "%d files could not be removed, such as %s: %s; the next sweep will try again",
                len(self.failed),
                name,
                error.strerror or type(error).__name__,
            )
