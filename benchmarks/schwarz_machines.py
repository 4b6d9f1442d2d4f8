"""Schwarz iterations over sweeps on the workers of a cluster: iterations, bytes between machines, time of processors.

    python benchmarks/schwarz_machines.py --size 1025 --workers 2

Workers are processes of this machine. Time is that of the processors of all workers and of the caller, over that of
sweeps in as many parts, for a mesh of the same accuracy. Bytes are those that subdomains would send if each had a
machine of its own, as the records say; sweeps are taken in as many parts as there are subdomains.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from distributed import Client, LocalCluster

import equimesh as em
from equimesh_cluster import Handle, SchwarzHandle, solve

T = TypeVar("T", bound=Handle)

U = "tanh(20*(hypot(x, y) - 0.7))"
DECOMPOSITIONS = ((2, 1), (4, 1), (8, 1), (16, 1), (32, 1), (4, 4))
# A sweep sends this many bytes for each point of a cut.
BYTES_OF_A_SWEEP = 64


def problem(n: int) -> em.Problem:
    """A problem with a steep ring."""
    return em.Problem(monitor=em.ArcLength(u=em.Expression(U)), grid=em.Grid(n_xi=n, n_eta=n))


def warm_up() -> None:
    """Compile and load what a solve needs."""
    em.solve(problem(65))
    em.solve(problem(65), em.Schwarz(subdomains=(2, 2)))


def processors(client: Client, work: Callable[[], T]) -> tuple[float, T]:
    """Seconds of the processors of all workers and of the caller, and the result of ``work``."""
    before, here = client.run(time.process_time), time.process_time()
    result = work()
    here = time.process_time() - here
    after = client.run(time.process_time)
    return here + sum(after[worker] - before[worker] for worker in after), result


def rows(client: Client, n: int) -> Iterator[str]:
    """Lines of the comparison."""
    swept, handle = processors(client, lambda: solve(problem(n), client, mode=em.Mode.TIGHT))
    with handle:
        finest = sum(record.grid.n_xi == n and record.step > 0 for record in handle.records[0])
        yield f"sweeps, {n} x {n}: {finest} on the finest level, {swept:.2f} s of processors"
    for subdomains in DECOMPOSITIONS:
        settings = em.Schwarz(subdomains=subdomains)
        seconds, found = processors(client, lambda: solve(problem(n), client, schwarz=settings))  # noqa: B023
        assert isinstance(found, SchwarzHandle)
        with found:
            said = sum(record.traffic for record in found.iterations)
            kept = found.traffic["kept"].bytes if "kept" in found.traffic else 0
            cuts = subdomains[0] - 1 + subdomains[1] - 1
            sweeps = max(finest, 1) * BYTES_OF_A_SWEEP * n * cuts
            yield (
                f"{subdomains[0]} x {subdomains[1]} subdomains: {len(found.iterations) - 1} iterations,"
                f" {said / 1e6:.2f} MB, {said / sweeps:.1f} times that of sweeps; {kept / 1e6:.0f} MB of kept copies;"
                f" processors {seconds / swept:.1f} times"
            )


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1025)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    options = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": ":0"}
    with LocalCluster(n_workers=arguments.workers, **options) as machines, Client(machines) as client:
        client.run(warm_up)
        warm_up()
        solve(problem(641), client).close()
        for line in rows(client, arguments.size):
            print(line, flush=True)


if __name__ == "__main__":
    main()
