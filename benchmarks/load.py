"""A service under load, from one time-stepping caller and from many. Needs `wrk` (Debian: apt install wrk).

The load comes from another program, over real connections, while the service runs in a process of its own. Every
request is for a new mesh, of other samples than the last, and waits for its file: no answer comes from an earlier mesh.
`probe` is the time of this machine for a fixed calculation: a value far above the usual one means a busy machine.

    python benchmarks/load.py
    python benchmarks/load.py --seconds 30 --workers 2
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

SCRIPT = Path(__file__).with_name("load.lua")
BODIES, BOUNDARY = 500, "equimesh-load"
MULTIPART = f"multipart/form-data; boundary={BOUNDARY}"


@dataclass(frozen=True, kw_only=True)
class Load:
    """A kind of request, and the number of connections."""

    name: str
    points: int
    format: str
    connections: int


LOADS = (
    Load(name="one caller, 65 x 65 samples, npz of 65 x 65 points", points=65, format="npz", connections=1),
    Load(name="one caller, 65 x 65 samples, vtu of 65 x 65 points", points=65, format="vtu", connections=1),
    Load(name="16 callers, 33 x 33 samples, npz of 33 x 33 points", points=33, format="npz", connections=16),
)


def body(points: int, number: int) -> bytes:
    """The multipart request for a mesh of step ``number`` of a moving front."""
    axis = np.linspace(0.0, 1.0, points)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    samples = io.BytesIO()
    np.savez(samples, x=axis, y=axis, values=np.tanh(20 * (x + y / 2 - 0.5 - 0.5 * number / BODIES)))
    spec = {"monitor": {"kind": "arc_length", "u": {"samples": "upload"}}, "grid": {"n_xi": points, "n_eta": points}}
    head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="spec"\r\nContent-Type: application/json\r\n\r\n'
    file = f'\r\n--{BOUNDARY}\r\nContent-Disposition: form-data; name="samples"; filename="u.npz"\r\n\r\n'
    return (head + json.dumps(spec) + file).encode() + samples.getvalue() + f"\r\n--{BOUNDARY}--\r\n".encode()


@contextmanager
def service(
    folder: Path, workers: int, *, under: Sequence[str] = (), variables: Mapping[str, str] | None = None
) -> Iterator[tuple[str, int]]:
    """The URL and the process id of a service that has warmed up, started by the command ``under``.

    It has these environment variables in addition.
    """
    command = [*under, sys.executable, "-m", "equimesh_cli", "serve", "--port", "0", "--workers", str(workers)]
    command += ["--data-dir", str(folder), "--log-level", "info", "--max-points", "5000000"]
    environment = {**os.environ, **(variables or {})}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None
    try:
        said = next(line for line in process.stderr if "listening on" in line)
        url = said.split()[-1]
        log = subprocess.Popen(
            ["cat"], stdin=process.stderr, stdout=subprocess.DEVNULL
        )  # a full pipe would block the service
        wait_until_ready(url, time.monotonic() + 300.0)
        yield url, process.pid
    finally:
        process.terminate()
        process.wait()
        log.wait()


def wait_until_ready(url: str, end: float) -> None:
    """Return when the workers of a service have warmed up."""
    while time.monotonic() < end:
        try:
            if httpx.get(f"{url}/readyz").status_code == 200:
                return
        except httpx.TransportError:
            pass  # not started yet
        time.sleep(0.2)
    raise SystemExit("the service did not become ready")


def measure(url: str, load: Load, seconds: float, *, warm_up: float = 2.0) -> dict[str, Any]:
    """The report of the load generator on ``seconds`` of a load, after ``warm_up`` seconds; times in milliseconds."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(BODIES):
            (Path(folder) / str(number)).write_bytes(body(load.points, number))
        path = f"/v1/meshes?format={load.format}&reuse=false"
        threads = "1" if load.connections == 1 else "2"
        for duration in (warm_up, seconds):
            command = ["wrk", f"-c{load.connections}", f"-t{threads}", f"-d{duration:g}s", "--timeout", "30s"]
            command += ["-s", str(SCRIPT), url, "--", folder, str(BODIES), MULTIPART, path]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return {"load": load.name, **found, "rate": found["made"] / found["seconds"], "probe": probe()}


def probe() -> float:
    """Milliseconds of a fixed calculation, the shortest of ten."""
    matrix, least = np.random.default_rng(1).standard_normal((192, 192)), np.inf
    for _ in range(10):
        began = time.perf_counter()
        np.linalg.inv(matrix @ matrix)
        least = min(least, time.perf_counter() - began)
    return 1e3 * least


def memory(pid: int) -> float:
    """Resident memory of a process, in MiB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


def large(url: str, pid: int, points: int) -> dict[str, Any]:
    """Time from the solve of a large mesh to its file, and the memory that the process needs to send it."""
    spec = {
        "monitor": {"kind": "arc_length", "u": {"expression": "(1-exp(15*(x-1)))*sin(pi*y)"}},
        "grid": {"n_xi": points, "n_eta": points},
    }
    with httpx.Client(base_url=url, timeout=600.0) as http:
        mesh = http.post("/v1/meshes?format=vtu&reuse=false", json=spec).raise_for_status().json()
        while mesh["status"] not in ("succeeded", "failed"):
            mesh = http.get(f"{mesh['links']['self']}?wait=30").raise_for_status().json()
        before, size = memory(pid), 0
        with http.stream("GET", mesh["links"]["file"]) as answer:
            for piece in answer.iter_bytes():
                size += len(piece)
        timings = mesh["timings"]
        return {
            "points": points,
            "status": mesh["status"],
            "solve": timings["solve"],
            "file after the solve": timings["write"],
            "MB": size / 1e6,
            "MiB more in the process": memory(pid) - before,
        }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each load."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each load (10)")
    parser.add_argument("--workers", type=int, default=2, help="of the service (2)")
    parser.add_argument("--large", type=int, default=1025, help="points a side of the large mesh, 0 for none (1025)")
    parser.add_argument("--json", action="store_true", help="a line of JSON for each")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as data, service(Path(data), options.workers) as (url, pid):
        for load in LOADS:
            found = measure(url, load, options.seconds)
            print(json.dumps(found) if options.json else _line(found), flush=True)
        if options.large:
            found = large(url, pid, options.large)
            print(json.dumps(found) if options.json else _large_line(found), flush=True)


def _line(found: dict[str, Any]) -> str:
    return (
        f"{found['load']}: median {found['median']:.1f} ms, p99 {found['p99']:.1f} ms, {found['rate']:.0f} meshes a "
        f"second; {found['made']} made, {found['refused']} refused, {found['failed']} failed "
        f"(probe {found['probe']:.2f} ms)"
    )


def _large_line(found: dict[str, Any]) -> str:
    return (
        f"{found['points']} x {found['points']} points: {found['status']}, solve {found['solve']:.2f} s, file "
        f"{found['file after the solve']:.2f} s after it; {found['MB']:.0f} MB sent with "
        f"{found['MiB more in the process']:.1f} MiB more in the process"
    )


if __name__ == "__main__":
    main()
