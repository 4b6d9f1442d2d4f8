"""Checks of the machine: processors and memory, within the limits of the system or a container."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from equimesh_cli.checks.findings import Finding, failed, ok, warning

if TYPE_CHECKING:
    from equimesh_service.settings import Settings

MIB = 1024 * 1024
CGROUPS, OWN_GROUP = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
MIN_WORKER_MIB = 128
"""Memory with which a worker can solve small meshes."""
# Version 1 writes "no limit" as a number near the largest one.
_NO_LIMIT = 1 << 60


def processors(settings: Settings) -> Finding | None:
    """Whether there is a processor for every worker and for each of its threads; None where a cluster solves."""
    if not settings.own_workers:
        return None
    from equimesh.numerics.threads import available_cores

    here, allowed = available_cores(), allowed_processors()
    count = float(here) if allowed is None else min(float(here), allowed)
    message = f"{settings.workers} workers with {settings.worker_threads} threads each, on {count:g} processors"
    if settings.workers > max(1.0, count):
        return warning(message, f"a solve keeps one processor busy: set EQUIMESH_WORKERS={max(1, int(count))}")
    if settings.workers * settings.worker_threads > max(1.0, count):
        return warning(message, "set EQUIMESH_THREADS=0, which divides the processors, or fewer EQUIMESH_WORKERS")
    return ok(message)


def memory(settings: Settings) -> Finding:
    """Whether there is memory for the limits of all workers."""
    from equimesh_service.settings import FILE_WORKERS, SERVICE_MIB

    present = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    allowed = allowed_memory()
    where = "machine" if allowed is None or allowed >= present else "container"
    room = (present if allowed is None else min(present, allowed)) // MIB
    processes = settings.own_workers + FILE_WORKERS
    most, least = settings.most_memory, processes * MIN_WORKER_MIB + SERVICE_MIB
    message = (
        f"{settings.own_workers} workers that solve and {FILE_WORKERS} for files may take {settings.memory_limit} MiB "
        f"each, the service {SERVICE_MIB} MiB: {most} MiB in all; this {where} has {room} MiB"
    )
    if room < least:
        return failed(message, f"give it at least {least} MiB, or set fewer EQUIMESH_WORKERS")
    if room < most:
        fits = max(16, (room - SERVICE_MIB) // processes)
        remedy = f"lower EQUIMESH_MEMORY_LIMIT to {fits}, or EQUIMESH_WORKERS; otherwise the system may kill workers"
        return warning(message, remedy)
    return ok(message)


def allowed_memory() -> int | None:
    """Bytes that the control groups of this process allow it; None without a limit."""
    found = [
        int(text)
        for text in _limits("memory", "memory.max", "memory.limit_in_bytes")
        if text.isdigit() and int(text) < _NO_LIMIT
    ]
    return min(found, default=None)


def allowed_processors() -> float | None:
    """Processors that the control groups of this process allow it; None without a limit."""
    found = []
    for text in _limits("cpu", "cpu.max", "cpu.cfs_quota_us"):
        quota, _, period = text.partition(" ")
        if quota.isdigit():
            found.append(int(quota) / int(period or 100_000))
    return min(found, default=None)


def _limits(controller: str, file: str, file_v1: str) -> Iterator[str]:
    """The texts of a file in the control group of this process and in all above it, in versions 1 and 2."""
    try:
        lines = OWN_GROUP.read_text().splitlines()
    except OSError:
        return  # not Linux
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, name = CGROUPS, file
        elif controller in controllers.split(","):
            root, name = CGROUPS / controllers, file_v1
            if not root.is_dir():
                root = CGROUPS / controller
        else:
            continue
        group = root / path.lstrip("/")
        # Inside a container the path may be that of the host, and its groups be mounted at the root.
        while group != root.parent:
            if (group / name).is_file():
                yield (group / name).read_text().strip()
            group = group.parent
