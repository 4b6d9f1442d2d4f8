"""The three ways to a mesh over functions that are hard: least error, Schwarz iteration, and what auto chooses.

Every cell is one solve with default settings and one thread. They are a part of docs/background/benchmarks.md, which
benchmarks/robustness_page.py writes from benchmarks/robustness_ways.json.

    python benchmarks/robustness_ways.py --points 33 65 129 --write
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from statistics import geometric_mean
from typing import Any, TypeAlias

from functions import FUNCTIONS

import equimesh as em

Result: TypeAlias = dict[str, Any]

DATA = Path(__file__).with_suffix(".json")
POINTS = (33, 65, 129)
SHOWN = 65
"""Points a side of the meshes in the page; all are in the data."""
SCHWARZ = em.Schwarz(subdomains=(2, 2), overlap=4)
WAYS: dict[str, tuple[Callable[[em.Field], em.Monitor], em.Schwarz | None]] = {
    "auto": (lambda u: em.Auto(u=u, purpose="interpolation"), None),
    "least error in L2": (lambda u: em.LeastError(u=u), None),
    "least error in H1": (lambda u: em.LeastError(u=u, norm="h1"), None),
    "Schwarz, arc length, 2 x 2": (lambda u: em.ArcLength(u=u), SCHWARZ),
}

SECTION = """
The same functions by other ways, `benchmarks/robustness_ways.py`. Gains are the geometric means, and the smallest, over
the functions. A mesh for L2 may have a gain below 1 in H1. CPU times are of a busy machine. `auto` is for
`interpolation`.
"""


def run(way: str, name: str, n: int) -> Result:
    """The result of a cell as plain numbers; an exception is a result, too."""
    result: Result = {"way": way, "name": name, "n": n}
    make, schwarz = WAYS[way]
    start = time.process_time()
    try:
        problem = em.Problem(monitor=make(em.Expression(FUNCTIONS[name].u)), grid=em.Grid(n_xi=n, n_eta=n))
        solution = em.solve(problem, schwarz, threads=1, check=False)
    except Exception as error:
        return result | {"exception": f"{type(error).__name__}: {error}"}
    cpu = round(time.process_time() - start, 3)
    certificate = solution.certificate.summary()
    chosen = [one["kind"] for one in certificate["comparison"] if one["chosen"]]
    return result | {
        "cpu": cpu,
        "status": certificate["status"],
        "folded": solution.mesh.is_folded,
        "gain": {norm: _short(gain) for norm, gain in (certificate["interpolation_gain"] or {}).items()},
        "jacobian": _short(certificate["min_jacobian"]),
        "iterations": max((one.iteration for one in solution.iterations), default=None),
        "chosen": chosen[0] if chosen else None,
    }


def _short(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.3g}")


def section(results: Sequence[Result]) -> Iterator[str]:
    """The lines of the section of the page."""
    yield SECTION
    yield (
        "| way | points a side | L2 gain: mean, smallest | H1 gain: mean, smallest | folded, exceptions | relaxed |"
        + (" CPU seconds: median, largest |")
    )
    yield "|---" * 7 + "|"
    for way in WAYS:
        here = [result for result in results if (result["way"], result["n"]) == (way, SHOWN)]
        if here:
            yield _row(way, SHOWN, here)
    iterations = [result["iterations"] for result in results if result.get("iterations") is not None]
    exact = [r["iterations"] for r in results if r.get("iterations") is not None and r["status"] == "converged"]
    yield ""
    if iterations:
        yield f"Schwarz iterations that solved the requested equations took {min(exact)} to {max(exact)}."


def _row(way: str, n: int, results: Sequence[Result]) -> str:
    done = [result for result in results if "exception" not in result]
    gains = []
    for norm in ("l2", "h1"):
        known = [result["gain"][norm] for result in done if result["gain"].get(norm)]
        gains.append(f"{geometric_mean(known):.2g}, {min(known):.2g}" if known else "-")
    cpu = sorted(result["cpu"] for result in done)
    bad = f"{sum(result['folded'] for result in done)}, {len(results) - len(done)}"
    relaxed = f"{sum(result['status'] == 'relaxed' for result in done)} of {len(done)}"
    times = f"{cpu[len(cpu) // 2]:.2g}, {cpu[-1]:.2g}" if cpu else "-"
    return f"| {way} | {n} | {gains[0]} | {gains[1]} | {bad} | {relaxed} | {times} |"


def read() -> list[Result]:
    """The stored results."""
    results: list[Result] = json.loads(DATA.read_text()) if DATA.exists() else []
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="*", default=list(POINTS), help="points a side")
    parser.add_argument("--functions", nargs="+", default=list(FUNCTIONS), choices=FUNCTIONS, help="names of functions")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="write the data")
    arguments = parser.parse_args()
    cells = list(product(WAYS, arguments.functions, sorted(arguments.points)))
    with ProcessPoolExecutor(arguments.processes, initializer=partial(run, "auto", "paper", 9)) as pool:
        results = []
        for result in pool.map(run, *zip(*cells, strict=True)):
            results.append(result)
            print(json.dumps(result), flush=True)
    if arguments.write:
        DATA.write_text("[\n" + ",\n".join(map(json.dumps, results)) + "\n]\n")
        print("write the page by: python benchmarks/robustness_page.py")


if __name__ == "__main__":
    main()
