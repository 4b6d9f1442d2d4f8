"""What a step of a sequence with two fields costs: in this process, and over HTTP.

CPU is that of all processes, the median (in process) or the mean (over HTTP) of some steps after a few others. The
front moves by a fraction of a cell in each step; u and both fields are given at the nodes of the mesh before.

    python benchmarks/steps.py
    python benchmarks/steps.py --steps 20 --kinds least_error --only process
"""

from __future__ import annotations

import argparse
import http.client
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from urllib.parse import urlsplit

import numpy as np
from budget import MovingMesh, send
from latency import cpu_seconds, settle
from load import probe, service

import equimesh as em

FRONT = "tanh(20*(x + y/2 - 0.5 - t))"
MOVE = 0.002
# Steps before the first that is counted.
WARM_UP = 4
KINDS = {"arc_length": em.ArcLength, "least_error": em.LeastError}


def in_process(kind: str, points: int, steps: int) -> float:
    """The processor time of a step with its certificate, in milliseconds."""
    problem = em.Problem(monitor=KINDS[kind](u=em.Expression(FRONT, t=0.0)), grid=em.Grid(n_xi=points, n_eta=points))
    meshes, found = em.Sequence(problem), list[float]()
    for number in range(1, WARM_UP + steps + 1):
        x, y = meshes.mesh.x, meshes.mesh.y
        u = em.Expression(FRONT, t=MOVE * number).evaluate(x, y)[0]
        began = time.process_time()
        step = meshes.step(u, {"p": np.sin(x) * y, "q": np.cos(y) * x})
        step.certificate.summary()
        found.append(time.process_time() - began)
    return 1e3 * median(found[WARM_UP:])


def over_http(url: str, pid: int, kind: str, points: int, steps: int) -> tuple[float, float]:
    """The processor time of a step in all processes of the service, and its median wall time, in milliseconds."""
    parts, moving = urlsplit(url), MovingMesh(points, kind)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=120)
    _, answer, location = send(connection, moving.first())
    before, walls = 0.0, list[float]()
    for number in range(WARM_UP + steps):
        if number == WARM_UP:
            before, walls = cpu_seconds(pid), []
        found, answer, location = send(connection, moving.next(location, answer))
        walls.append(found["total"])
    connection.close()
    return 1e3 * (cpu_seconds(pid) - before) / steps, median(walls)


def rows(kinds: Sequence[str], points: int, steps: int, only: str | None) -> Iterator[str]:
    """The rows of the table, each as soon as it is measured."""
    if only != "http":
        for kind in kinds:
            yield f"| {kind}, in process | {in_process(kind, points, steps):.0f} ms | |"
    if only != "process":
        with tempfile.TemporaryDirectory() as data, service(Path(data), 1) as (url, pid):
            settle(pid)
            for kind in kinds:
                cpu, wall = over_http(url, pid, kind, points, steps)
                yield f"| {kind}, over HTTP | {cpu:.0f} ms | {wall:.0f} ms |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=65, help="points a side (65)")
    parser.add_argument("--steps", type=int, default=15, help="of each row (15)")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), help="monitors (all)")
    parser.add_argument("--only", choices=["process", "http"], help="one of the two places (both)")
    options = parser.parse_args(arguments)
    print(f"load {os.getloadavg()[0]:.1f}, probe {probe():.2f} ms", flush=True)
    print("| a step of a sequence | CPU | wall |\n|---|---|---|", flush=True)
    for row in rows(options.kinds, options.points, options.steps, options.only):
        print(row, flush=True)
    print(f"load {os.getloadavg()[0]:.1f}, probe {probe():.2f} ms")


if __name__ == "__main__":
    main()
