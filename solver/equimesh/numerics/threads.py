"""Threads that share work on a mesh."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

from equimesh.errors import InputError
from equimesh_schema.document import is_whole

# Threads of one solve.
MAX_THREADS = 64


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(threads: int | None) -> int:
    """The requested number of threads, all cores for ``None``; raises :class:`~equimesh.errors.InputError`."""
    if threads is None:
        return min(available_cores(), MAX_THREADS)
    if not is_whole(threads) or not 1 <= threads <= MAX_THREADS:
        raise InputError(
            f"threads = {threads!r}: a whole number between 1 and {MAX_THREADS}, or None for one on every core",
            field="threads",
        )
    return int(threads)


def run_on_threads(threads: int, work: Callable[[int], None]) -> None:
    """Call ``work(k)`` for every k below ``threads``, each in its own thread, and wait for all."""
    others = [_pool(threads - 1).submit(work, k) for k in range(1, threads)] if threads > 1 else []
    work(0)
    for other in others:
        other.result()


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="equimesh")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has none of its parent's threads
