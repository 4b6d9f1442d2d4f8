"""Syncs of the disk for each mesh that is stored before its answer: for one caller, and for 16. Needs `strace`.

Counts `fsync` and `fdatasync` of the service and of its workers, also those of checkpoints of the database. Every
request is for a new mesh of other samples, and waits for its file.

    python benchmarks/syncs.py
    python benchmarks/syncs.py --meshes 500 --workers 2
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import httpx
from load import MULTIPART, body, service

CALLERS = (1, 16)
POINTS = 33
TRACE = ("strace", "--daemonize", "--follow-forks", "--seccomp-bpf", "--quiet=all", "--trace=fsync,fdatasync")


def count(trace: Path) -> int:
    """The syncs in a record of strace; one that another process interrupts has two lines."""
    return sum(" resumed>" not in line for line in trace.read_text().splitlines())


def send(http: httpx.Client, number: int) -> None:
    """Request one mesh, and wait for its file."""
    headers = {"Content-Type": MULTIPART, "Accept": "application/x-npz", "Prefer": "wait=30"}
    answer = http.post("/v1/meshes?reuse=false", content=body(POINTS, number), headers=headers)
    if answer.status_code != 201:
        raise SystemExit(f"the service answered {answer.status_code}: {answer.text[:200]}")


def measure(url: str, trace: Path, callers: int, meshes: int) -> float:
    """Syncs for each of so many meshes."""
    limits = httpx.Limits(max_connections=callers)
    with httpx.Client(base_url=url, timeout=60.0, limits=limits) as http, ThreadPoolExecutor(callers) as pool:
        list(pool.map(partial(send, http), range(callers)))
        time.sleep(1.0)
        before = count(trace)
        list(pool.map(partial(send, http), range(callers, callers + meshes)))
    time.sleep(1.0)  # strace writes what it has seen
    return (count(trace) - before) / meshes


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each number of callers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=int, default=200, help="of each number of callers (200)")
    parser.add_argument("--workers", type=int, default=2, help="of the service (2)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        data, trace = Path(folder) / "data", Path(folder) / "trace"
        with service(data, options.workers, under=[*TRACE, f"--output={trace}"]) as (url, _):
            for callers in CALLERS:
                found = measure(url, trace, callers, options.meshes)
                print(f"{callers} callers: {found:.2f} syncs a mesh (load {os.getloadavg()[0]:.0f})", flush=True)


if __name__ == "__main__":
    main()
