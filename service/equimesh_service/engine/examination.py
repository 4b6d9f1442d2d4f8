"""An examination of a cluster, without a job: its workers, and what is wrong with each of them for a service."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from distributed import Client, Worker
from distributed.system import MEMORY_LIMIT

from equimesh_service.engine.cluster_pool import describe_difference, versions
from equimesh_service.engine.port import PackedCall

MIB = 1024 * 1024
# The longest wait for the scheduler.
_MAX_CONNECT_SECONDS = 5.0


@dataclass(frozen=True, kw_only=True)
class WorkerExamination:
    """The examination of a worker.

    ``slots`` is the number of jobs that it takes at the same time, ``memory`` that of its machine in MiB. ``fault`` is
    the reason why a service cannot use it, "" without one.
    """

    name: str
    slots: int = 0
    memory: int = 0
    fault: str = ""


@dataclass(frozen=True, kw_only=True)
class Examination:
    """The examination of a cluster: the ``address`` that its scheduler reports, and its workers."""

    address: str
    workers: list[WorkerExamination]


def examine(scheduler: str, check: PackedCall | None) -> Examination:
    """The examination of the cluster of ``scheduler``; raises OSError where no scheduler answers.

    Every worker calls ``check``, which returns a fault or "". Nothing is called where ``check`` is None.
    """
    client: Any = Client(scheduler, timeout=_MAX_CONNECT_SECONDS, set_as_default=False, name="equimesh-doctor")
    try:
        identity = client.sync(client.scheduler.identity, n_workers=-1)
        known = identity["workers"]
        answers = client.run(_look_around, check, on_error="return") if known else {}
    finally:
        client.close()
    workers = [
        _examined(str(known[address]["name"]), answer) for address, answer in answers.items() if address in known
    ]
    return Examination(address=str(identity["address"]), workers=workers)


async def _look_around(check: PackedCall | None, dask_worker: Worker) -> dict[str, Any]:
    """The versions, slots, memory and fault of a worker; called on the worker."""
    return {
        "versions": versions(),
        "slots": dask_worker.state.nthreads,
        "memory": MEMORY_LIMIT // MIB,
        "fault": "" if check is None else str(await asyncio.to_thread(check)),
    }


def _examined(name: str, answer: Any) -> WorkerExamination:
    if isinstance(answer, ModuleNotFoundError):
        return WorkerExamination(name=name, fault=f"it has no equimesh of this release ({answer})")
    if isinstance(answer, Exception):
        return WorkerExamination(name=name, fault=f"it does not answer as expected ({type(answer).__name__}: {answer})")
    different = describe_difference(versions(), answer["versions"])
    fault = f"it has {different}" if different else answer["fault"]
    return WorkerExamination(name=name, slots=answer["slots"], memory=answer["memory"], fault=fault)
