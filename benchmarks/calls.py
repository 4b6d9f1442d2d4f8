"""Processor time of a small solve and of an npz file, next to what they take one compiled loop, one array at a time.

    python benchmarks/calls.py [points a side ...]

Each row: the points a side, where u comes from, milliseconds of a solve whose sweeps are made one by one, of one whose
sweeps are made in few compiled calls, and their quotient; the same of the bytes of its npz file by ``numpy.savez`` and
in memory, and of the samples in it by ``zipfile`` and in memory. Both ways take turns in one process, and the shortest
time of each counts: processor time of one thread. Both give the same mesh, to the last bit, which is checked.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable
from unittest.mock import patch

import numpy as np

import equimesh as em
from equimesh.io.npz import mesh_arrays, npz_bytes
from equimesh.io.reading.bounds import open_zip
from equimesh.single_domain import level

U = "tanh(20*(x + y/2 - 0.75))"
SAMPLES = 65
SIZES = {33: 60, 65: 60, 129: 30, 257: 10, 1025: 3}
"""Points a side, and the runs of which the shortest counts."""


def problem(n: int, kind: str) -> em.Problem:
    """The arc-length mesh of a formula, or of samples of it, with n points a side."""
    u: em.Field = em.Expression(U)
    if kind == "samples":
        axis = np.linspace(0.0, 1.0, SAMPLES)
        u = em.GridSamples(x=axis, y=axis, values=u.evaluate(*np.meshgrid(axis, axis, indexing="ij"))[0])
    return em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=n, n_eta=n))


def in_turns(ways: tuple[Callable[[], object], Callable[[], object]], runs: int) -> tuple[float, float]:
    """Milliseconds of both ways, the shortest of ``runs`` after one that compiles."""
    found: tuple[list[float], list[float]] = ([], [])
    for _ in range(runs + 1):
        for way, times in zip(ways, found, strict=True):
            begin = time.thread_time()
            way()
            times.append(time.thread_time() - begin)
    before, after = (1e3 * min(times[1:]) for times in found)
    return before, after


def row(n: int, kind: str, runs: int) -> str:
    """The numbers of one size and one kind of u."""
    case = problem(n, kind)

    def one_by_one() -> em.Solution:
        with patch.object(level, "is_one_strip", lambda *_: False):
            return em.solve(case, threads=1)

    solution = em.solve(case, threads=1)
    if solution.mesh.x.tobytes() != one_by_one().mesh.x.tobytes():
        raise AssertionError(f"{n} x {n}, {kind}: the two meshes differ")
    solving = in_turns((one_by_one, lambda: em.solve(case, threads=1)), runs)
    data = solution.data()
    arrays = mesh_arrays(data, data.mesh.cells, 1)
    writing = in_turns((lambda: np.savez(io.BytesIO(), **arrays), lambda: npz_bytes(arrays)), runs)
    content = npz_bytes({"x": solution.mesh.x, "y": solution.mesh.y, "values": solution.mesh.x})

    def read() -> None:
        with open_zip(content, "npz", len(content), "") as members:
            for name in members.names:
                members.read(name)

    def read_by_zipfile() -> None:
        with patch("equimesh.io.reading.bounds._Stored.of", lambda _: None):
            read()

    reading = in_turns((read_by_zipfile, read), runs)
    pairs = (f"{before:8.2f} {after:8.2f} {before / after:5.1f}" for before, after in (solving, writing, reading))
    return f"{n:6d} {kind:8} " + "  ".join(pairs)


def main() -> None:
    """Print a row for every size and kind of u."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("points", nargs="*", type=int, default=list(SIZES), help="points a side")
    print("points u          solve: one by one, few calls  npz: savez, memory       read: zipfile, memory")
    for n in parser.parse_args().points:
        for kind in ("samples", "formula"):
            print(row(n, kind, SIZES.get(n, 10)), flush=True)


if __name__ == "__main__":
    main()
