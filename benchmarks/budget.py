"""Where the time of one small mesh goes, part by part, from the header Server-Timing of each answer.

One caller sends samples of a moving front over one connection, and waits for each mesh as npz. `http` is what the
header cannot tell: the time on the wire, in the server before the first line of the service, and in the caller.

    python benchmarks/budget.py
    python benchmarks/budget.py --points 33 --meshes 500 --body npz
    python benchmarks/budget.py --sequence
"""

from __future__ import annotations

import argparse
import http.client
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from load import BODIES, MULTIPART, body, probe, service

# Requests before the first that is counted.
WARM_UP = 50
NPZ = "application/x-npz"
# The parts in the order of the way through the service.
PARTS = ("receive", "check", "store", "build", "solve", "quality", "file", "commit", "hand-over", "answer", "http")
MEANING = {
    "receive": "read the body and take it apart",
    "check": "validate the spec, read the samples, make the spline",
    "store": "look for an equal mesh, reserve a worker",
    "build": "the problem in the worker",
    "solve": "the mesh",
    "quality": "quality, gains, certificate",
    "file": "the npz file, its hash, on disk",
    "commit": "one transaction, on disk",
    "hand-over": "to the worker and back",
    "answer": "headers, and the first bytes",
    "http": "the wire, the server, the caller",
}


@dataclass(frozen=True)
class Request:
    """A request: its path, media type and body."""

    path: str
    media_type: str
    body: bytes


def npz_body(points: int, number: int) -> bytes:
    """The same request as :func:`load.body`, as one npz: nothing in it is text but the spec."""
    axis = np.linspace(0.0, 1.0, points)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    spec = {"monitor": {"kind": "arc_length", "u": {"samples": "upload"}}, "grid": {"n_xi": points, "n_eta": points}}
    file = io.BytesIO()
    values = np.tanh(20 * (x + y / 2 - 0.5 - 0.5 * number / BODIES))
    np.savez(file, x=axis, y=axis, values=values, spec=np.array(json.dumps(spec)))
    return file.getvalue()


def meshes(points: int, kind: str) -> Iterator[Request]:
    """Requests for meshes of a moving front, without end."""
    number = 0
    while True:
        sent = body(points, number) if kind == "multipart" else npz_body(points, number)
        path = "/v1/meshes?format=npz&reuse=false"
        yield Request(path, MULTIPART if kind == "multipart" else NPZ, sent)
        number = (number + 37) % BODIES


class MovingMesh:
    """A sequence with two fields: each step has u and the fields at the nodes of the mesh before."""

    def __init__(self, points: int, kind: str = "arc_length") -> None:
        self.points, self.kind, self.step, self.path = points, kind, 0, ""

    def first(self) -> Request:
        """The request that begins it."""
        spec = {
            "monitor": {"kind": self.kind, "u": {"expression": "tanh(20*(x + y/2 - 0.5))"}},
            "grid": {"n_xi": self.points, "n_eta": self.points},
        }
        return Request("/v1/sequences?format=npz", "application/json", json.dumps(spec).encode())

    def next(self, location: str, answer: bytes) -> Request:
        """The next step, on the mesh of the last answer."""
        self.path = self.path or f"{urlsplit(location).path}/steps?format=npz"
        with np.load(io.BytesIO(answer)) as mesh:
            x, y = mesh["x"], mesh["y"]
        file, front = io.BytesIO(), 0.5 + 0.002 * (self.step + 1)
        fields = {"p": np.sin(x) * y, "q": np.cos(y) * x}
        np.savez(file, step=self.step, u=np.tanh(20 * (x + y / 2 - front)), **fields)  # type: ignore[arg-type]
        self.step += 1
        return Request(self.path, NPZ, file.getvalue())


def send(connection: http.client.HTTPConnection, request: Request) -> tuple[dict[str, float], bytes, str]:
    """The milliseconds of each part of one request, the answer, and its location."""
    began = time.perf_counter()
    headers = {"Content-Type": request.media_type, "Prefer": "wait=60"}
    connection.request("POST", request.path, request.body, headers)
    answer = connection.getresponse()
    data = answer.read()
    total = 1e3 * (time.perf_counter() - began)
    if answer.status != 201:
        raise SystemExit(f"{answer.status}: {data[:500]!r}")
    parts = {name: float(dur) for name, dur in (part.split(";dur=") for part in _listed(answer))}
    return {**parts, "http": total - sum(parts.values()), "total": total}, data, answer.headers["Location"]


def _listed(answer: http.client.HTTPResponse) -> list[str]:
    said = answer.headers["Server-Timing"]
    return said.split(", ") if said else []


def measure(url: str, number: int, source: Callable[[str, bytes], Request]) -> list[dict[str, float]]:
    """The parts of ``number`` requests, after a warm-up."""
    address = urlsplit(url)
    connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=120)
    found, answer, location = [], b"", ""
    for _ in range(number + WARM_UP):
        parts, answer, location = send(connection, source(location, answer))
        found.append(parts)
    connection.close()
    return found[WARM_UP:]


def table(found: Sequence[dict[str, float]]) -> str:
    """The median of each part, and the median and the 99th percentile of the whole."""
    lines = ["| part | median ms | what |", "|---|---|---|"]
    known = [part for part in PARTS if any(part in parts for parts in found)]
    for part in known:
        lines.append(f"| {part} | {np.median([p.get(part, 0.0) for p in found]):.2f} | {MEANING[part]} |")
    totals = [parts["total"] for parts in found]
    lines.append(f"| **total** | **{np.median(totals):.1f}** | 99th percentile {np.percentile(totals, 99):.1f} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the budget."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=65, help="points a side (65)")
    parser.add_argument("--meshes", type=int, default=300, help="how many are measured (300)")
    parser.add_argument("--body", choices=["multipart", "npz"], default="multipart", help="the form of the request")
    parser.add_argument("--sequence", action="store_true", help="steps of a sequence with two fields")
    parser.add_argument("--workers", type=int, default=2, help="of the service (2)")
    parser.add_argument("--json", action="store_true", help="the medians as one line of JSON")
    options = parser.parse_args(arguments)
    stream, steps = meshes(options.points, options.body), MovingMesh(options.points)

    def source(location: str, answer: bytes) -> Request:
        if not options.sequence:
            return next(stream)
        return steps.next(location, answer) if answer else steps.first()

    with tempfile.TemporaryDirectory() as data, service(Path(data), options.workers) as (url, _):
        found = measure(url, options.meshes, source)
    if options.json:
        print(json.dumps({part: float(np.median([p.get(part, 0.0) for p in found])) for part in (*PARTS, "total")}))
    else:
        print(table(found))
        print(f"(probe {probe():.2f} ms)", file=sys.stderr)


if __name__ == "__main__":
    main()
