"""What a small mesh costs over HTTP: kept, not kept, and next to two floors, in one table of one run.

`echo` is a bare FastAPI application that reads the same multipart body and answers with as many bytes; `solve` is the
call in this process: spline, solve, certificate and npz. CPU is that of all processes of a server together. Every
request has other samples than the last. `probe` is the time of this machine for a fixed calculation.

    python benchmarks/latency.py
    python benchmarks/latency.py --meshes 300 --points 33 65
"""

from __future__ import annotations

import argparse
import http.client
import io
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from urllib.parse import urlsplit

import numpy as np
from load import MULTIPART, body, probe, service, wait_until_ready

# Requests before the first that is counted.
WARM_UP = 20
CALLERS = 16
# The most processor time that an idle server takes in 2 s.
_IDLE_SECONDS = 0.1
PATHS = {"not kept": "/v1/meshes?format=npz&store=false", "kept": "/v1/meshes?format=npz&reuse=false"}
ECHO = """
import sys
import uvicorn
from fastapi import FastAPI, Request, Response

app, sizes = FastAPI(), {}

@app.get("/readyz")
async def ready():
    return "ok"

@app.post("/v1/meshes")
async def create(request: Request):
    form = await request.form()
    sent = await form["samples"].read()
    return Response(sizes.setdefault(len(sent), bytes(4 * len(sent))), media_type="application/x-npz")

uvicorn.run(app, port=int(sys.argv[1]), log_level="warning", access_log=False)
"""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """A row of the table: CPU of one mesh in milliseconds, its wall time and the 99th percentile, meshes a second.

    ``first`` is the part of the CPU that the process has which answers the requests.
    """

    what: str
    points: int
    cpu: float
    first: float
    wall: float
    late: float
    rate: float

    @classmethod
    def of(cls, what: str, points: int, cpu: tuple[float, float], seconds: Sequence[float], wall: float) -> Cost:
        """The row of meshes that took so many ``seconds`` each, all together ``wall``.

        ``cpu`` are the seconds of all processes, and of the one that answers.
        """
        count, slow = len(seconds), sorted(seconds)[min(len(seconds) - 1, int(0.99 * len(seconds)))]
        every, first = (1e3 * part / count for part in cpu)
        return cls(
            what=what,
            points=points,
            cpu=every,
            first=first,
            wall=1e3 * median(seconds),
            late=1e3 * slow,
            rate=count / wall,
        )

    def line(self) -> str:
        """The row as text."""
        numbers = (self.cpu, self.first, self.wall, self.late)
        return f"{self.what:22} {self.points:4}^2 {' '.join(f'{one:9.1f}' for one in numbers)} {self.rate:9.0f}"


HEAD = f"{'':22} {'points':>6} {'CPU ms':>9} {'of API':>9} {'wall ms':>9} {'99 %':>9} {'a second':>9}"


class Watch:
    """Counts the processor time of a server from its making on."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._before, self._began = self._now(), time.perf_counter()

    def _now(self) -> tuple[float, float]:
        return cpu_seconds(self._pid), _own_seconds(self._pid)

    def cost(self, what: str, points: int, seconds: Sequence[float]) -> Cost:
        """The cost of the requests since then, which took so many ``seconds`` each."""
        wall = time.perf_counter() - self._began
        (every, first), (every_before, first_before) = self._now(), self._before
        return Cost.of(what, points, (every - every_before, first - first_before), seconds, wall)


def cpu_seconds(pid: int) -> float:
    """Processor time of a process and its descendants until now, also of those that ended."""
    return sum(map(_own_seconds, _family(pid)))


def _family(pid: int) -> Iterator[int]:
    yield pid
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            yield from _family(int(child))


def _own_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def settle(pid: int) -> None:
    """Return when a server has nothing to do: all its workers have started, too."""
    before = float("-inf")
    while (now := cpu_seconds(pid)) - before > _IDLE_SECONDS:
        before = now
        time.sleep(2.0)


@contextmanager
def echo() -> Iterator[tuple[str, int]]:
    """The URL and the process id of the bare application."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([sys.executable, "-c", ECHO, str(port)])
    try:
        wait_until_ready(f"http://127.0.0.1:{port}", time.monotonic() + 60.0)
        yield f"http://127.0.0.1:{port}", process.pid
    finally:
        process.terminate()
        process.wait()


def ask(url: str, path: str, bodies: Sequence[bytes]) -> list[float]:
    """The seconds of each request, one after the other over one connection."""
    parts, seconds = urlsplit(url), []
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=60.0)
    for content in bodies:
        began = time.perf_counter()
        while True:  # a busy service says when to ask again
            connection.request("POST", path, content, {"Content-Type": MULTIPART, "Prefer": "wait=30"})
            answer = connection.getresponse()
            data = answer.read()
            if answer.status != 503:
                break
            time.sleep(0.1)
        if answer.status not in (200, 201):
            raise SystemExit(f"{path}: {answer.status} {data[:300]!r}")
        seconds.append(time.perf_counter() - began)
    connection.close()
    return seconds


def one_caller(what: str, url: str, pid: int, path: str, points: int, meshes: int) -> Cost:
    """The cost for a caller who waits for each mesh before the next."""
    bodies = [body(points, number) for number in range(WARM_UP + meshes)]
    ask(url, path, bodies[:WARM_UP])
    watch = Watch(pid)
    return watch.cost(what, points, ask(url, path, bodies[WARM_UP:]))


def many_callers(what: str, url: str, pid: int, path: str, points: int, meshes: int) -> Cost:
    """The cost for callers at the same time, each of whom waits for his mesh."""
    bodies = [body(points, number) for number in range(meshes)]
    found: list[float] = []
    threads = [
        threading.Thread(target=lambda own: found.extend(ask(url, path, own)), args=(bodies[number::CALLERS],))
        for number in range(CALLERS)
    ]
    watch = Watch(pid)
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return watch.cost(f"{what}, {CALLERS} callers", points, found)


def in_process(points: int, meshes: int) -> Cost:
    """The cost of the calls alone."""
    import equimesh as em
    from equimesh.io.write import mesh_bytes

    axis = np.linspace(0.0, 1.0, points)
    grid = em.Grid(n_xi=points, n_eta=points)

    def solve(number: int) -> None:
        values = np.tanh(20 * (axis[:, None] + axis / 2 - 0.5 - number / 1000))
        monitor = em.ArcLength(u=em.GridSamples(x=axis, y=axis, values=values))
        solution = em.solve(em.Problem(monitor=monitor, grid=grid), threads=1)
        solution.certificate.summary()
        io.BytesIO(mesh_bytes(solution.data(), format="npz"))

    return _timed("solve", points, meshes, solve)


def _timed(what: str, points: int, meshes: int, work: Callable[[int], None]) -> Cost:
    for number in range(WARM_UP):
        work(number)
    before, began, seconds = time.process_time(), time.perf_counter(), []
    for number in range(meshes):
        start = time.perf_counter()
        work(number)
        seconds.append(time.perf_counter() - start)
    wall, cpu = time.perf_counter() - began, time.process_time() - before
    return Cost.of(what, points, (cpu, cpu), seconds, wall)


def costs(sizes: Sequence[int], meshes: int, workers: int) -> Iterator[Cost]:
    """All rows, each as soon as it is measured."""
    with echo() as (url, pid):
        for points in sizes:
            yield one_caller("echo", url, pid, PATHS["not kept"], points, meshes)
        yield many_callers("echo", url, pid, PATHS["not kept"], sizes[0], 4 * meshes)
    for points in sizes:
        yield in_process(points, meshes)
    with tempfile.TemporaryDirectory() as data, service(Path(data), workers) as (url, pid):
        settle(pid)
        for what, path in PATHS.items():
            for points in sizes:
                yield one_caller(what, url, pid, path, points, meshes)
            yield many_callers(what, url, pid, path, sizes[0], 4 * meshes)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[33, 65, 129], help="a side (33 65 129)")
    parser.add_argument("--meshes", type=int, default=100, help="of each row (100)")
    parser.add_argument("--workers", type=int, default=2, help="of the service (2)")
    options = parser.parse_args(arguments)
    print(f"load {os.getloadavg()[0]:.1f}, probe {probe():.2f} ms\n{HEAD}", flush=True)
    for cost in costs(options.points, options.meshes, options.workers):
        print(cost.line(), flush=True)
    print(f"load {os.getloadavg()[0]:.1f}, probe {probe():.2f} ms")


if __name__ == "__main__":
    main()
