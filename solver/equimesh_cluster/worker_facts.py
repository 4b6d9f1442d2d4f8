"""What a worker says about itself before the start: versions, threads and memory."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import psutil
from distributed import Client

from equimesh_cluster.connection import no_scheduler
from equimesh_cluster.errors import ClusterError
from equimesh_cluster.messages import install

if TYPE_CHECKING:
    from distributed import Worker

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
    """Look at the scheduler, which reads the tasks that it hands on.

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
    """Refuse workers, or a scheduler, with other versions than those of this process, by their names.

    Raises :class:`~equimesh_cluster.errors.ClusterError`.
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
