"""Measurements in a new process: memory, and the time of compiling and loading."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from costs.rows import Row, cpu_seconds

MEMORY_GOAL, GROWTH_GOAL, COMPILE_GOAL = 100.0, 1.6, 15.0
HUGE, LARGE_RUNS, HUGE_RUNS = 4097, 5, 3


def memory(n: int, smaller: int) -> Iterator[Row]:
    """Memory per point at ``n`` points a side, and the cost of a point compared with that at ``smaller``."""
    found = _fresh("solve_large", n, smaller)
    goals = (MEMORY_GOAL, GROWTH_GOAL) if n == HUGE else (None, None)
    note = f"peak above that of the import: {found['bytes'] / 1e6:.0f} MB"
    value = found["bytes"] / n**2
    yield Row(what=f"n = {n}, memory", value=value, unit="B/point", goal=goals[0], note=note)
    each = 1e9 * found["large"] / n**2, 1e9 * found["small"] / smaller**2
    note = f"{each[0]:.0f} and {each[1]:.0f} ns/point in one process"
    what = f"n = {n}, cost of a point over that at {smaller}"
    yield Row(what=what, value=each[0] / each[1], unit="x", goal=goals[1], note=note, counts=found["counts"])


def kernels() -> Iterator[Row]:
    """CPU time of compiling all kernels, and of importing and loading them."""
    with tempfile.TemporaryDirectory() as folder:
        first, again = (_fresh("use_all_kernels", EQUIMESH_CACHE_DIR=folder) for _ in range(2))
    note = f"{first['total']:.1f} s in an empty cache, {again['total']:.1f} s the next time"
    what, value = "compile the kernels, once on a machine", first["total"] - again["total"]
    counts = {"kernels": first["compiled"], "left out": first["kernels"] - first["compiled"]}
    yield Row(what=what, value=value, unit="s", goal=COMPILE_GOAL, note=note, counts=counts)
    yield Row(what="import, CPU time", value=again["import"], unit="s", note="numba and scipy are most of it")
    what = "first mesh of a process, n = 33, CPU time"
    yield Row(what=what, value=again["first"], unit="s", note="loads the kernels")


def _fresh(function: str, *arguments: int, **variables: str) -> dict[str, Any]:
    """The result of a function of this module in a process of its own."""
    code = f"from {__name__} import {function} as work; import json; print(json.dumps(work{arguments!r}))"
    environment = {**os.environ, **variables, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise RuntimeError(f"{function} failed:\n{done.stderr}")
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def solve_large(n: int, smaller: int) -> dict[str, Any]:
    """Peak memory of one solve, then CPU times; for a process of its own."""
    import equimesh as em
    from costs.solves import front

    before, counts = _peak(), {}

    def observe(event: em.Event) -> None:
        if isinstance(event, em.Step):
            counts[str(max(event.grid.shape))] = event.step

    em.solve(front(n), threads=1, observe=observe)
    used = _peak() - before
    small, _ = cpu_seconds(lambda: em.solve(front(smaller), threads=1), LARGE_RUNS)
    large, _ = cpu_seconds(lambda: em.solve(front(n), threads=1), HUGE_RUNS)
    return {"bytes": used, "large": large, "small": small, "counts": counts}


def use_all_kernels() -> dict[str, Any]:
    """Call every kernel once; for a process of its own."""
    start = time.process_time()
    import numpy as np
    from numba.core.dispatcher import Dispatcher

    import equimesh as em

    imported = time.process_time()
    u, grid, sector = em.Expression("tanh(5*(x - y))"), em.Grid(n_xi=33, n_eta=33), em.AnnulusSector()
    arc, curvature = em.ArcLength(u=u), em.Curvature(u=u)
    em.solve(em.Problem(monitor=arc, grid=grid), threads=1)
    first = time.process_time()
    small, both = em.Grid(n_xi=9, n_eta=9), em.Intersection(monitors=(arc, curvature))
    for problem in (
        em.Problem(monitor=arc, grid=em.Grid(n_xi=65, n_eta=65)),  # from two coarser grids
        em.Problem(monitor=arc, grid=small, domain=sector),
        em.Problem(monitor=em.Smoothed(monitor=both), grid=small),
        em.Problem(monitor=curvature, grid=small),
    ):
        solution = em.solve(problem, threads=1, check=False)
        _, _ = solution.quality, solution.certificate
    curvature.on(sector).weakened(0.5).metric(np.array([1.5]), np.array([0.5]))
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == "equimesh"]
    found = {id(v): v for module in modules for v in vars(module).values() if isinstance(v, Dispatcher)}
    return {
        "import": imported - start,
        "first": first - imported,
        "total": time.process_time(),
        "kernels": len(found),
        "compiled": sum(1 for kernel in found.values() if kernel.signatures),
    }


def _peak() -> int:
    """The peak memory of this process, in bytes.

    On Linux ``ru_maxrss`` includes the memory of the parent when it started the process; ``VmHWM`` does not.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
