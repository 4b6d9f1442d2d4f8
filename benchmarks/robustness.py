"""How well requested meshes are reached, over functions, parameters and grids, by their certificates.

Every cell is one solve with default settings and one thread. Results go to a file of JSON lines, one a cell; cells that
it holds already are not run again. With ``--write`` the file is turned into docs/background/benchmarks.md and
benchmarks/robustness.json.

    python benchmarks/robustness.py cells.jsonl --points 33 65 129 257 --write
"""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import robustness_page
from functions import FUNCTIONS

import equimesh as em

PARAMETERS = ((0.7, 0.05), (1.0, 0.05), (0.7, 0.005), (1.0, 0.0))
POINTS = (33, 65, 129, 257)
MAX_CPU_SECONDS = 300.0


class Cell(NamedTuple):
    """One solve: the name of the function, the monitor's parameters, points a side."""

    name: str
    a: float
    b: float
    n: int


def run(cell: Cell) -> dict[str, Any]:
    """The result of a cell as plain numbers; an exception is a result, too."""
    steps = 0

    def observe(event: em.Event) -> None:
        nonlocal steps
        steps += isinstance(event, em.Step) and event.grid == problem.grid

    result: dict[str, Any] = cell._asdict()
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, MAX_CPU_SECONDS)
    start = time.process_time()
    try:
        monitor = em.ArcLength(u=em.Expression(FUNCTIONS[cell.name].u), a=cell.a, b=cell.b)
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=cell.n, n_eta=cell.n))
        solution = em.solve(problem, observe=observe, threads=1, check=False)
        result |= {"cpu": round(time.process_time() - start, 3), "steps": steps}
        return result | measures(solution)
    except Exception as error:
        return result | {"cpu": round(time.process_time() - start, 3), "exception": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def measures(solution: em.Solution) -> dict[str, Any]:
    """The numbers of a solution for the table."""
    certificate = solution.certificate.summary()
    relaxed = {one["what"]: one["reached"] for one in certificate["relaxed"]}
    quality, gain = solution.quality, certificate["interpolation_gain"]
    return {
        "status": certificate["status"],
        "relaxed": {what: _short(reached) for what, reached in relaxed.items()},
        "residual": _short(certificate["equation_residual"]),
        "jacobian": _short(certificate["min_jacobian"]),
        "folded": solution.mesh.is_folded,
        "q_eq": _short(quality.q_eq.max),
        "gain": _short(gain["l2"]),
    }


def _short(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.3g}")


def _too_long(*_: object) -> None:
    raise TimeoutError(f"more than {MAX_CPU_SECONDS:g} CPU seconds")


def known(path: Path) -> Iterator[dict[str, Any]]:
    """The results in a file of JSON lines; none without the file."""
    if path.exists():
        yield from map(json.loads, path.read_text().splitlines())


def run_missing(path: Path, points: list[int], names: list[str], processes: int) -> None:
    """Run the cells that the file lacks, coarse grids first, and append their results."""
    done = {Cell(*(result[field] for field in Cell._fields)) for result in known(path)}
    wanted = [Cell(name, a, b, n) for n, (a, b), name in product(sorted(points), PARAMETERS, names)]
    with ProcessPoolExecutor(processes, initializer=run, initargs=(Cell("paper", 0.7, 0.05, 33),)) as pool:
        futures = [pool.submit(run, cell) for cell in wanted if cell not in done]
        for future in as_completed(futures):
            line = json.dumps(future.result())
            with path.open("a") as file:
                file.write(line + "\n")
            print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, help="file of JSON lines, new or continued")
    parser.add_argument("--points", type=int, nargs="*", default=list(POINTS), help="points a side")
    parser.add_argument("--functions", nargs="+", default=list(FUNCTIONS), choices=FUNCTIONS, help="names of functions")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="write the page and its data")
    arguments = parser.parse_args()
    run_missing(arguments.results, arguments.points, arguments.functions, arguments.processes)
    if arguments.write:
        robustness_page.write(list(known(arguments.results)))


if __name__ == "__main__":
    main()
