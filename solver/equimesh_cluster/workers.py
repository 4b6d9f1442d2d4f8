"""The workers of a cluster: what they are, which part each takes, and whether their memory is enough."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import psutil
from distributed import Client

from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.meshes.mesh import Grid
from equimesh_cluster.channel import install
from equimesh_cluster.connection import no_scheduler
from equimesh_cluster.errors import ClusterError
from equimesh_cluster.parts.rows import rows_here
from equimesh_schema.document import is_whole

if TYPE_CHECKING:
    from distributed import Worker


# What a worker says about itself before the start: versions, threads and memory.

PACKAGES = ("equimesh", "numpy", "numba", "dask", "distributed")
"""The packages whose versions have to be the same on all machines."""
ENDING = ("stopping", "stopped", "closing", "closing_gracefully", "closed", "failed")
"""The statuses of a worker that ends, in Dask's words."""
PAUSED = "paused"
"""The status of a worker that takes no tasks until it has more memory."""


@dataclass(frozen=True)
class WorkerFacts:
    """One worker of a cluster.

    ``identity`` belongs to one process: a worker that was started again at the same address has another one.
    Memory is in bytes; ``limit`` is 0 where the worker has none. ``status`` is Dask's own word.
    """

    address: str
    identity: str
    host: str
    threads: int
    versions: dict[str, str]
    limit: int
    used: int
    free: int
    status: str = "running"


def versions() -> dict[str, str]:
    """The versions of this process of all :data:`PACKAGES`."""
    return {name: _version(name) for name in PACKAGES}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return str(getattr(import_module(package), "__version__", "unknown"))


async def examine(dask_worker: Worker) -> WorkerFacts:
    """The facts of the worker on which it runs, which from then on takes messages of parts."""
    await install(dask_worker)
    return WorkerFacts(
        address=dask_worker.address,
        identity=dask_worker.id,
        host=dask_worker.ip,
        threads=dask_worker.state.nthreads,
        versions=versions(),
        limit=int(dask_worker.memory_manager.memory_limit or 0),
        used=psutil.Process(os.getpid()).memory_info().rss,
        free=psutil.virtual_memory().available,
        status=dask_worker.status.name,
    )


def examine_workers(client: Client, addresses: Collection[str] | None = None) -> list[WorkerFacts]:
    """The facts of all workers of a cluster, or of those at ``addresses``, in the order of their addresses.

    A worker that is lost meanwhile is left out, and so is one that is about to end. Raises
    :class:`~equimesh_cluster.errors.ClusterError` where a worker has no equimesh, or another version of a package, and
    where it is paused.
    """
    try:
        alive = sorted(client.nthreads() if addresses is None else client.nthreads(workers=list(addresses)))
        answers: dict[str, Any] = client.run(examine, workers=alive, on_error="return") if alive else {}
        left = client.nthreads(workers=alive)
    except (OSError, asyncio.CancelledError, TimeoutError) as error:
        raise no_scheduler(client) from error
    facts = []
    for address, answer in sorted(answers.items()):
        if isinstance(answer, WorkerFacts):
            facts.append(answer)
        elif address in left:
            raise _without_equimesh(f"the worker {address}", answer)
    check_versions({one.address: one.versions for one in facts})
    _require_none_paused(facts)
    return [one for one in facts if one.status not in ENDING]


def _require_none_paused(facts: Collection[WorkerFacts]) -> None:
    """Refuse workers that take no tasks, by their names: a part would wait for them in vain."""
    paused = [one.address for one in facts if one.status == PAUSED]
    if paused:
        raise ClusterError(
            f"paused, so that they take no tasks: {', '.join(paused[:3])}{' and others' if len(paused) > 3 else ''}."
            " Dask pauses a worker at 80 % of its memory limit: free its memory, raise its limit, or start it again"
        )


def examine_scheduler(client: Client) -> None:
    """Check the packages of the scheduler, which unpacks the tasks that it passes on.

    Raises :class:`~equimesh_cluster.errors.ClusterError` where it has no equimesh, or another version of a package.
    """
    try:
        found = client.run_on_scheduler(versions)
    except ImportError as error:
        raise _without_equimesh("the scheduler", error) from error
    except (OSError, asyncio.CancelledError, TimeoutError) as error:
        raise no_scheduler(client) from error
    check_versions({"the scheduler": found})


def check_versions(versions_of: Mapping[str, Mapping[str, str]]) -> None:
    """Refuse workers, or a scheduler, whose versions differ from the versions of this process.

    Raises :class:`~equimesh_cluster.errors.ClusterError`, which names them.
    """
    here = versions()
    found = [
        f"{name} has {package} {there.get(package, 'unknown')}, and {here[package]} is here"
        for name, there in versions_of.items()
        for package in PACKAGES
        if there.get(package) != here[package]
    ]
    if found:
        more = f"; {len(found) - 3} more differences" if len(found) > 3 else ""
        raise ClusterError(
            f"versions differ: {'; '.join(found[:3])}{more}. Install the same versions on all machines, and start the"
            " workers again"
        )


def _without_equimesh(name: str, error: object) -> ClusterError:
    """The error of a worker or scheduler that cannot even be examined."""
    wanted = versions()["equimesh"]
    if isinstance(error, ImportError):
        return ClusterError(
            f"{name} has no equimesh {wanted} ({error}): install equimesh[dask]=={wanted} there, and start it again"
        )
    return ClusterError(f"{name} could not be examined: {error}")


# Which worker runs which part of a run.


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
    if not is_whole(parts):
        raise InputError(f"parts = {parts!r}: a whole number, or None for one on every worker", field="parts")


def count_of_parts(client: Client, parts: int | None, most: int, reason: str) -> int:
    """The number of parts: by default one for each worker, at most ``most``, of which there is a ``reason``.

    Raises :class:`~equimesh.errors.InputError` for more.
    """
    if parts is None:
        return max(1, min(most, len(examine_workers(client))))
    require_count(parts)
    if parts > most:
        raise InputError(
            f"parts = {parts}: {reason}, so take at most {most}, or more subdomains or grid points", field="parts"
        )
    return parts


# Bytes that a part takes for each of its points, at its peak.
BYTES_A_POINT = 65
# Bytes that the spline through samples in a file takes for each of them.
BYTES_A_SAMPLE = 8
# The share of its limit at which a worker of Dask is ended.
LIMIT_SHARE = 0.95
GIGABYTE = 1e9


def check_memory(
    problem: Problem,
    places: Sequence[WorkerFacts],
    bytes_a_point: int = BYTES_A_POINT,
    rows: Sequence[int] | None = None,
) -> None:
    """Refuse workers without the memory for their parts of ``problem``.

    ``rows`` are the rows that each part holds, by default those of parts that are cut between strips. Raises
    :class:`~equimesh_cluster.errors.ClusterError`, which names the worker or the machine and both numbers.
    """
    grid, count = problem.grid, len(places)
    samples = memory_of_samples(problem, count)
    held = rows_of_parts(grid, count) if rows is None else rows
    needs = [bytes_a_point * row_count * grid.n_eta + samples for row_count in held]
    for worker, parts in Counter(place.address for place in places).items():
        facts = next(place for place in places if place.address == worker)
        needed = sum(need for need, place in zip(needs, places, strict=True) if place.address == worker)
        if facts.limit and needed > LIMIT_SHARE * facts.limit - facts.used:
            free = max(0.0, LIMIT_SHARE * facts.limit - facts.used)
            raise _too_little(f"the worker {worker}", parts, needed, f"{_text(free)} left of its memory limit", grid)
    for host, parts in Counter(place.host for place in places).items():
        free = min(place.free for place in places if place.host == host)
        needed = sum(need for need, place in zip(needs, places, strict=True) if place.host == host)
        if needed > free:
            raise _too_little(f"the machine {host}", parts, needed, f"{_text(free)} free", grid)


def rows_of_parts(grid: Grid, count: int) -> list[int]:
    """The rows that each of ``count`` parts holds: parts are cut between strips, so few strips make uneven parts."""
    return [last - first for first, last in rows_here(grid.shape, count)]


def equal_rows(grid: Grid, count: int) -> list[int]:
    """The rows that each of ``count`` nearly equal parts holds."""
    return [-(-grid.n_xi // count) + 2] * count


def memory_of_samples(problem: Problem, count: int) -> int:
    """Bytes of the splines that each of ``count`` parts keeps where u is samples in a file: its share of them.

    A part evaluates u in its own share of the domain. It keeps no more than the ``max_bytes`` of the samples.
    """
    u = problem.monitor.u
    if not isinstance(u, ChunkedSamples):
        return 0
    n, m = u.shape
    return min(u.max_bytes, BYTES_A_SAMPLE * n * m // count)


def _too_little(what: str, parts: int, needed: int, has: str, grid: Grid) -> ClusterError:
    """The error of too little memory."""
    those = "a part" if parts == 1 else f"{parts} parts"
    return ClusterError(
        f"{what} has {has}, and {those} of {grid} points take {_text(needed)}: take more workers on more"
        " machines, raise the memory limit of the workers, or take a coarser grid"
    )


def _text(size: float) -> str:
    return f"{size / GIGABYTE:.3g} GB"
