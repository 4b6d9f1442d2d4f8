"""Weak and strong scaling of a mesh in parts on this machine, as ratios; a large mesh by parts; a model on paper.

    python benchmarks/cluster.py                                    strong and weak scaling
    python benchmarks/cluster.py --size 16385 --parts 2 --write pvtu a mesh by parts, written and read back
    python benchmarks/cluster.py --model                            65537 x 65537 on 64 to 1000 workers, on paper

Workers are processes of this machine. The time of processors of all of them is compared with that of one process which
solves the same mesh whole. Ratios of wall times say little where there are fewer cores than parts.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from distributed import Client, LocalCluster

import equimesh as em
from equimesh_cluster import PARTED_FORMATS, Handle, read_parts, run_parts, solve

U = "tanh(20*(hypot(x, y) - 0.7))"


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one solve took: processor seconds of all workers, wall seconds, and the largest memory of a worker."""

    cpu: float
    wall: float
    bytes_a_point: float
    peak: float
    sent: int
    messages: int


def problem(n_xi: int, n_eta: int, u: str = U) -> em.Problem:
    """A problem with a steep ring."""
    return em.Problem(monitor=em.ArcLength(u=em.Expression(u)), grid=em.Grid(n_xi=n_xi, n_eta=n_eta))


@contextmanager
def cluster(workers: int) -> Iterator[Client]:
    """A client of ``workers`` processes with one thread each."""
    options: dict[str, Any] = {"threads_per_worker": 1, "memory_limit": 0, "dashboard_address": ":0"}
    with LocalCluster(n_workers=workers, processes=True, **options) as machines, Client(machines) as client:
        yield client


def memory(what: str) -> int:
    """A memory of this process in bytes: VmHWM, the largest since the last reset, or VmRSS, that of now."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(what))


def begin() -> tuple[float, int]:
    """Processor time and memory of a worker before a solve; its largest memory is counted from here."""
    Path("/proc/self/clear_refs").write_text("5")
    return time.process_time(), memory("VmRSS")


def end() -> tuple[float, int]:
    """Processor time and largest memory of a worker after a solve."""
    return time.process_time(), memory("VmHWM")


def in_parts(client: Client, what: em.Problem, parts: int) -> tuple[Handle, Cost]:
    """A mesh in parts, and what it took."""
    before, started = client.run(begin), time.perf_counter()
    handle = solve(what, client, parts=parts)
    wall, after = time.perf_counter() - started, client.run(end)
    cpu = sum(after[worker][0] - before[worker][0] for worker in after)
    grown = max(after[worker][1] - before[worker][1] for worker in after)
    traffic = handle.traffic.values()
    cost = Cost(
        cpu=cpu,
        wall=wall,
        bytes_a_point=grown * parts / what.grid.points,
        peak=max(peak for _, peak in after.values()),
        sent=sum(one.bytes for one in traffic),
        messages=sum(one.messages for one in traffic),
    )
    return handle, cost


def whole(_: Any, what: em.Problem) -> tuple[float, float]:
    """Processor and wall seconds of a solve by one thread of one process."""
    cpu, wall = time.process_time(), time.perf_counter()
    em.solve(what, threads=1)
    return time.process_time() - cpu, time.perf_counter() - wall


def warm_up(client: Client, parts: int) -> None:
    """Compile and load on every worker what a solve needs."""
    small = problem(1025 if parts > 8 else 641, 641)
    client.run(_solve_small)
    solve(small, client, parts=parts).close()


def _solve_small() -> None:
    em.solve(problem(65, 65), threads=1)


def scaling(sizes: Sequence[int], most: int) -> Iterator[str]:
    """Lines of strong scaling, the same mesh by more parts, and of weak scaling, as many points for each part."""
    n = max(sizes)
    yield f"strong scaling, {n} x {n}: parts, CPU of all / of one process, wall of one / of all, bytes a point, MB sent"
    with cluster(1) as client:
        warm_up(client, 1)
        alone = run_parts(client, whole, lambda _, __: (problem(n, n),), parts=1).futures[0].result()
    counts = [2**k for k in range(int(math.log2(most)) + 1)]
    for parts in counts:
        with cluster(parts) as client:
            yield _row(client, parts, (n, n), alone)
    yield "weak scaling, the rows grow with the parts"
    base = (n - 1) // most
    for parts in counts:
        rows = base * parts + 1
        with cluster(parts) as client:
            warm_up(client, parts)
            shape = (rows, n)
            alone = run_parts(client, whole, lambda _, __: (problem(*shape),), parts=1).futures[0].result()  # noqa: B023
            yield _row(client, parts, shape, alone)


def _row(client: Client, parts: int, shape: tuple[int, int], alone: tuple[float, float]) -> str:
    warm_up(client, parts)
    handle, cost = in_parts(client, problem(*shape), parts)
    with handle:
        return (
            f"  {shape[0]} x {shape[1]}, {parts} parts: CPU {cost.cpu / alone[0]:.2f}, wall {alone[1] / cost.wall:.2f},"
            f" {cost.bytes_a_point:.0f} bytes a point, {cost.sent / 1e6:.2f} MB in {cost.messages} messages"
        )


def large(n: int, parts: int, written: str | None, folder: str | None) -> Iterator[str]:
    """A mesh of n x n points by parts; written by its workers where a format is given, and read back by them."""
    with cluster(parts) as client:
        warm_up(client, parts)
        handle, cost = in_parts(client, problem(n, n), parts)
        with handle:
            yield f"{n} x {n} = {n * n / 1e6:.0f} million points in {parts} parts: {handle.message}"
            yield f"  solved in {cost.wall:.0f} s, {cost.cpu:.0f} s of processors"
            yield f"  memory: at most {cost.peak / 1e9:.2f} GB a worker, {cost.bytes_a_point:.1f} bytes a point"
            yield f"  sent: {cost.sent / 1e6:.1f} MB in {cost.messages} messages between the parts"
            yield "  sweeps: " + ", ".join(f"{count} at {grid}" for grid, count in sweeps(handle).items())
            if written is not None:
                yield from _write_and_read(client, handle, written, folder)


def sweeps(handle: Handle) -> dict[str, int]:
    """How many sweeps each level took that was solved in parts."""
    found: dict[str, int] = {}
    for record in handle.records[0]:
        found[str(record.grid)] = max(found.get(str(record.grid), 0), record.step)
    return found


def _write_and_read(client: Client, handle: Handle, written: str, folder: str | None) -> Iterator[str]:
    place = Path(mkdtemp(prefix="equimesh-", dir=folder))
    try:
        started = time.perf_counter()
        head = handle.write(place / f"mesh{PARTED_FORMATS[written].suffix}", q_eq=False)
        size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
        yield f"  written as {written} in {time.perf_counter() - started:.0f} s, {size / 1e9:.2f} GB"
        started = time.perf_counter()
        same = read_back(client, handle, str(head))
        result = "equal to the last bit" if same else "DIFFERENT"
        yield f"  read back in {time.perf_counter() - started:.0f} s: {result}"
    finally:
        shutil.rmtree(place)


def read_back(client: Client, handle: Handle, head: str) -> bool:
    """Whether x and y in files are equal to those on the workers. Some rows are read at a time."""
    found, step = read_parts(head), max(1, 4_000_000 // handle.grid.n_eta)
    for name, array in (("x", handle.x), ("y", handle.y)):
        for first in range(0, handle.grid.n_xi, step):
            last = min(first + step, handle.grid.n_xi)
            if not np.array_equal(found.rows(name, first, last), client.compute(array[first:last]).result()):
                return False
    return True


@dataclass(frozen=True, kw_only=True)
class Machines:
    """What the model of many machines takes: the first four are measured here, the others are of a network."""

    level_seconds: float = 45e-9
    """Processor seconds of a level for each of its points: one sweep, and the interpolation before it."""
    coarse_seconds: float = 0.2
    """Seconds of the coarsest levels, which take many sweeps."""
    bytes_a_point: float = 65.0
    """Memory of a part for each of its points."""
    start_seconds: float = 0.5
    """Seconds until 64 parts run and have their coarse solution; it grows with their number."""
    message_seconds: float = 1e-3
    """Seconds of one message without contents."""
    bytes_a_second: float = 1.25e9
    """Bytes that a network of 10 Gb/s takes in a second."""
    coarse: int = 1025
    """Points in each direction of the coarse solution, at least."""
    strip_rows: int = 16
    """Rows of a strip, at least; a part has one strip of every level that is solved in parts."""


def model(n: int, parts: int, machines: Machines) -> dict[str, float]:
    """Seconds of a mesh of n x n points in ``parts`` parts: coarse solution, work, messages, start; the efficiency."""
    levels = [n]
    while (coarse := (levels[-1] - 1) // 2 + 1) > machines.coarse and coarse - 2 >= machines.strip_rows * parts:
        levels.append(coarse)
    work = sum(machines.level_seconds * m * m / parts for m in levels)
    alone = machines.coarse_seconds + machines.level_seconds * coarse * coarse * 4 / 3
    depth, messages = math.ceil(math.log2(parts)), 0.0
    for m in levels if parts > 1 else ():
        sums = 2 * depth * machines.message_seconds + 32.0 * m * depth / machines.bytes_a_second
        agreement = depth * machines.message_seconds
        halos = 4 * machines.message_seconds + (32.0 + 6 * 16.0) * m / machines.bytes_a_second
        messages += sums + agreement + halos
    start = machines.start_seconds * parts / 64
    total = alone + work + messages + start
    return {
        "coarse points": coarse,
        "GB a part": machines.bytes_a_point * n * n / parts / 1e9,
        "coarse": alone,
        "work": work,
        "messages": messages,
        "start": start,
        "seconds": total,
        "efficiency": work / total,
    }


def on_paper(machines: Machines) -> Iterator[str]:
    """Lines of the model."""
    yield "on paper: 10 Gb/s, 1 ms a message"
    for n, parts in ((16385, 4), (65537, 64), (65537, 128), (131073, 256), (262145, 1000)):
        found = model(n, parts, machines)
        yield (
            f"  {n} x {n} on {parts} workers: {found['GB a part']:.1f} GB a part, {found['coarse']:.1f} s for"
            f" {found['coarse points']:.0f} points a side by one, {found['work']:.1f} s of work,"
            f" {found['messages']:.2f} s of messages, {found['start']:.1f} s to start: {found['seconds']:.1f} s,"
            f" efficiency {100 * found['efficiency']:.0f} %"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what the arguments ask for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", type=int, help="points in each direction of one mesh by parts")
    parser.add_argument("--parts", type=int, default=4, help="how many parts, or the most of the scaling")
    parser.add_argument("--write", choices=[*PARTED_FORMATS], help="also write the mesh, and read it back")
    parser.add_argument("--folder", help="where to write; the files are removed again")
    parser.add_argument("--scaling", type=int, default=2049, help="points in each direction of the scaling")
    parser.add_argument("--model", action="store_true", help="the model of many machines, on paper")
    chosen = parser.parse_args(arguments)
    if chosen.model:
        lines = on_paper(Machines())
    elif chosen.size:
        lines = large(chosen.size, chosen.parts, chosen.write, chosen.folder)
    else:
        lines = scaling([chosen.scaling], chosen.parts)
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
