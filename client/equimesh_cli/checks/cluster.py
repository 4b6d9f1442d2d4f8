"""The check of a cluster: its scheduler, and whether its workers can solve the meshes of this service."""

from __future__ import annotations

from typing import TYPE_CHECKING

from equimesh_cli.checks.findings import Finding, failed, ok, warning

if TYPE_CHECKING:
    from equimesh_service.engine.packed_call import PackedCall
    from equimesh_service.settings import Settings


def cluster(settings: Settings) -> Finding | None:
    """Whether the cluster of the engine dask can be used; None for a service that needs none."""
    if settings.engine != "dask":
        return None
    from equimesh_service.engine.examination import examine

    place = f"the cluster at {settings.scheduler}"
    check = _check_of(settings)
    try:
        found = examine(settings.scheduler, check)
    except (OSError, ValueError) as error:
        message = f"the scheduler at {settings.scheduler} cannot be reached ({type(error).__name__})"
        return failed(message, "start it by dask scheduler --host ADDRESS; check the address, and the settings of TLS")
    workers = found.workers
    if not workers:
        return failed(f"{place} has no workers", f"start one: equimesh worker --scheduler {settings.scheduler}")
    faults = [f"worker {worker.name}: {worker.fault}" for worker in workers if worker.fault]
    if faults:
        remedy = "install the release of the service on all workers, and let them reach its database and files"
        all_of_them = len(faults) == len(workers)
        return (failed if all_of_them else warning)(f"{place}: {'; '.join(faults)}", remedy)
    small = [worker for worker in workers if worker.slots * settings.memory_limit > worker.memory]
    slots = sum(worker.slots for worker in workers)
    message = f"{place}: {len(workers)} workers solve {slots} meshes at the same time, in the versions of this service"
    if small:
        first = small[0]
        message += (
            f"; worker {first.name} has {first.memory} MiB for {first.slots} meshes of {settings.memory_limit} MiB each"
        )
        return warning(message, "lower EQUIMESH_MEMORY_LIMIT, or give the worker fewer processes")
    if is_open(found.address):
        message += f"; whoever reaches the scheduler at {found.address} can run programs on all of them"
        remedy = "use TLS, see docs/how-to/cluster.md; on one machine: dask scheduler --host 127.0.0.1"
        return warning(message, remedy)
    reached = "all reach the database and the files" if check is not None else "the first start checks what they reach"
    return ok(f"{message}; {reached}")


def is_open(address: str) -> bool:
    """Whether other machines can reach a scheduler at this address without a certificate."""
    from equimesh_service.upkeep.exposure import is_loopback

    protocol, _, place = address.rpartition("://")
    return protocol != "tls" and not is_loopback(place.rpartition(":")[0])


def _check_of(settings: Settings) -> PackedCall | None:
    """The check of what workers reach; None before the first start, when there is nothing to reach."""
    from equimesh_service.engine.packed_call import PackedCall
    from equimesh_service.files.address import files_address
    from equimesh_service.worker.job import Storage
    from equimesh_service.worker.reach import Reach

    reach = Reach.of(Storage(settings.database, files_address(settings)), mark=False)
    return PackedCall.of(reach.describe_faults) if reach.is_marked else None
