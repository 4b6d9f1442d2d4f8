"""Which worker runs which part of a run."""

from __future__ import annotations

from collections.abc import Sequence

from equimesh.errors import InputError
from equimesh_cluster.worker_facts import WorkerFacts


def place(count: int, workers: Sequence[WorkerFacts]) -> list[WorkerFacts]:
    """The worker of each of ``count`` parts: neighbours next to each other, shares as equal as threads allow.

    All parts of a run have to run at the same time, so a worker takes at most one part for each of its threads. Raises
    :class:`~equimesh.errors.InputError` for more parts than threads, with the largest number.
    """
    require_count(count)
    threads = sum(worker.threads for worker in workers)
    if not 1 <= count <= threads:
        raise InputError(
            f"parts = {count}: all parts run at the same time, and the {len(workers)} workers have {threads} threads in"
            f" all: take 1 to {threads} parts, or start more workers",
            field="parts",
        )
    shares = [0] * len(workers)
    for _ in range(count):
        free = [k for k, worker in enumerate(workers) if shares[k] < worker.threads]
        shares[min(free, key=lambda k: shares[k])] += 1
    return [worker for worker, share in zip(workers, shares, strict=True) for _ in range(share)]


def require_count(parts: object) -> None:
    """Raise :class:`~equimesh.errors.InputError` for a number of parts that is no whole number."""
    if not isinstance(parts, int) or isinstance(parts, bool):
        raise InputError(f"parts = {parts!r}: a whole number, or None for one on every worker", field="parts")
