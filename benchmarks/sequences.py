"""The cost of a step of a moving mesh: the solve, the transfer of a field in each way, and what else a step does.

    python benchmarks/sequences.py [POINTS]

CPU time on one thread, the median of several steps of a front that moves by a fraction of a cell.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

import equimesh as em

STEPS = 7
FRONT = "tanh(30*(x + y/2 - 0.7 - t))"
MOVE = 0.002


def seconds(work: Callable[[], object]) -> float:
    """CPU time of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def steps_of(monitor: em.Monitor, n: int) -> tuple[float, list[em.Mesh]]:
    """The median time of a step without fields, and the meshes."""
    meshes = em.Sequence(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)))
    times, found = [], [meshes.mesh]
    for number in range(1, STEPS + 1):
        u = em.Expression(FRONT, t=MOVE * number).evaluate(meshes.mesh.x, meshes.mesh.y)[0]
        times.append(seconds(partial(meshes.step, u)))
        found.append(meshes.mesh)
    return float(np.median(times)), found


def transfer_times(meshes: list[em.Mesh]) -> dict[str, float]:
    """The median time of a transfer of one field, and of eight, from mesh to mesh."""
    found: dict[str, list[float]] = {}
    for old, new in pairwise(meshes):
        nodal = np.tanh(30 * (old.x - 0.5))
        fields = {
            "spline, nodes": em.MeshValues(nodal),
            "conservative, nodes": em.MeshValues(nodal, transfer="conservative"),
            "conservative, cells": em.MeshValues(nodal[1:, 1:], transfer="conservative", location="cells"),
            "conservative, cells, 8 components": em.MeshValues(
                np.stack(8 * [nodal[1:, 1:]], axis=-1), transfer="conservative", location="cells"
            ),
        }
        for name, field in fields.items():
            work = seconds(partial(em.transfer, old, {"q": field}, new))
            found.setdefault(name, []).append(work)
    return {name: float(np.median(times)) for name, times in found.items()}


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 65
    u = em.Expression(FRONT)
    curvature = em.Smoothed(monitor=em.Curvature(u=u), radius=0.02)
    for name, monitor in (
        ("arc length", em.ArcLength(u=u)),
        ("curvature", curvature),
        ("least error", em.LeastError(u=u)),
    ):
        step, meshes = steps_of(monitor, n)
        print(f"{n} x {n}, {name}: a step without fields {1e3 * step:.1f} ms")
        for way, cost in transfer_times(meshes).items():
            print(f"    {way}: {1e3 * cost:.1f} ms, {1e6 * cost / n**2:.2f} microseconds a point")


if __name__ == "__main__":
    main()
