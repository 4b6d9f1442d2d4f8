"""Iterations and rates of Schwarz iterations: all kinds, with and without line corrections and acceleration.

Measured is the error against the single-domain mesh, from the interpolated mesh of a grid half as fine; counted are the
iterations until it is a millionth of what it was. Every measurement is printed as a line of JSON, and written to
``--output``; ``--tables`` prints tables of such a file.

    python benchmarks/schwarz_rates.py --output rates.json
    python benchmarks/schwarz_rates.py --tables rates.json
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from functions import FUNCTIONS

NAMES = ("paper", "sine", "ring", "tanh20", "tanh60", "wave")
CUTS = ((2, 1), (4, 1), (8, 1), (16, 1), (32, 1), (2, 2), (4, 4), (8, 8), (3, 5))
KINDS = ("optimized", "local", "classical", "nonlinear_robin", "linear_robin")
# Fewer cuts for kinds that need many iterations, or a factorisation in every step; and the limit in seconds.
FEW_CUTS, LONGEST = ((2, 1), (8, 1), (4, 4)), 6.0
GOAL, MOST = 1e-6, 30


def condition(kind: str) -> Any:
    """The transmission condition of a kind."""
    import equimesh as em

    kinds = {
        "optimized": em.Optimized(),
        "local": em.Optimized(data=em.LineData.LOCAL),
        "classical": em.Classical(),
        "nonlinear_robin": em.NonlinearRobin(),
        "linear_robin": em.LinearRobin(),
    }
    return kinds[kind]


@cache
def case(name: str, n: int) -> tuple[Any, Any, Any]:
    """The problem, the start of its iterations and its single-domain mesh."""
    import equimesh as em
    from equimesh.meshes.nested import prolong

    problem = em.Problem(
        monitor=em.ArcLength(u=em.Expression(FUNCTIONS[name].u), a=0.7, b=0.05), grid=em.Grid(n_xi=n, n_eta=n)
    )
    half = replace(problem, grid=em.Grid(n_xi=(n + 1) // 2, n_eta=(n + 1) // 2))
    start = prolong(em.solve(half, mode=em.Mode.TIGHT).reference, problem.grid)
    one = em.Schwarz(line_correction=10, tolerance=1e-13, max_iterations=20)
    return problem, start, em.solve(problem, one, check=False).reference


def measure(name: str, n: int, settings: Any) -> dict[str, Any]:
    """The errors of the iterations, their number to :data:`GOAL`, and the two rates."""
    import equimesh as em
    from equimesh.schwarz.rates import predicted_rate, steps_to_exact
    from equimesh.schwarz.records import observed_rate

    problem, start, reference = case(name, n)
    errors: list[float] = []
    conditions = set()
    begin = time.process_time()
    for record in em.iterate(problem, settings, start, reference):
        errors.append(float(record.error or 0.0))
        conditions.add(record.transmission)
        reached = errors[-1] <= GOAL * errors[0]
        if record.failed or len(errors) > MOST or time.process_time() - begin > LONGEST:
            break
        if reached and (errors[-1] < 1e-10 or len(errors) > 8):
            break
    decomposition = settings.decompose(problem.grid)
    return {
        "iterations": next((k for k, e in enumerate(errors) if e <= GOAL * errors[0]), None),
        "failed": record.failed,
        "ran": len(errors) - 1,
        "rate": observed_rate(errors, 1e-11),
        "predicted": predicted_rate(decomposition, settings),
        "steps": steps_to_exact(decomposition, settings),
        "errors": [float(f"{e:.3g}") for e in errors],
    }


def runs(kinds: Sequence[str]) -> Iterator[tuple[str, str, tuple[int, int], int, str]]:
    """Kind, function, subdomains, line corrections, acceleration."""
    for kind in kinds:
        for corrections, acceleration in itertools.product((0, 1, 3), ("none", "anderson")):
            few = kind not in ("optimized", "classical") or (kind == "classical" and corrections == 0)
            if kind.endswith("robin") and (corrections == 0) == (acceleration == "anderson"):
                continue
            for name, cut in itertools.product(NAMES, FEW_CUTS if few else CUTS):
                yield kind, name, cut, corrections, acceleration


def rows(kinds: Sequence[str], n: int, overlap: int) -> Iterator[dict[str, Any]]:
    """All measurements on n x n points."""
    import equimesh as em

    for kind, name, cut, corrections, acceleration in runs(kinds):
        settings = em.Schwarz(
            subdomains=cut,
            overlap=overlap,
            transmission=condition(kind),
            line_correction=corrections,
            acceleration=em.Acceleration(acceleration),
            fallback=False,
            tolerance=None,
        )
        what = {"kind": kind, "u": name, "subdomains": cut, "corrections": corrections, "acceleration": acceleration}
        yield {**what, "n": n, "overlap": overlap, **measure(name, n, settings)}


def shown(row: dict[str, Any] | None) -> str:
    """The number of iterations of a measurement, or the reason why there is none."""
    if row is None:
        return ""
    if row["iterations"] is not None:
        return str(row["iterations"])
    return "stalls" if row["failed"] else f">{row['ran']}"


def tables(path: Path) -> Iterator[str]:
    """Markdown tables of the iterations of every kind, by function and subdomains."""
    found = [json.loads(line) for line in path.read_text().splitlines()]
    key = ("kind", "corrections", "acceleration", "u")
    by = {(*(row[k] for k in key), tuple(row["subdomains"])): row for row in found}
    for kind in KINDS:
        cuts = [cut for cut in CUTS if any(k[0] == kind and k[4] == cut for k in by)]
        yield f"\n{kind}\n\n| corrections, acceleration | u | " + " | ".join("{} x {}".format(*c) for c in cuts) + " |"
        yield "|---" * (len(cuts) + 2) + "|"
        for corrections, acceleration, name in itertools.product((0, 1, 3), ("none", "anderson"), NAMES):
            cells = [by.get((kind, corrections, acceleration, name, cut)) for cut in cuts]
            if any(cells):
                yield f"| {corrections}, {acceleration} | {name} | " + " | ".join(map(shown, cells)) + " |"


def main() -> None:
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--points", type=int, default=65, help="points a side")
    parser.add_argument("--overlap", type=int, default=2)
    parser.add_argument("--output", type=Path, help="a file for the measurements")
    parser.add_argument("--tables", type=Path, help="make the tables of such a file")
    options = parser.parse_args()
    if options.tables is not None:
        print("\n".join(tables(options.tables)))
        return
    with (options.output or Path(os.devnull)).open("w") as file:
        for row in rows(options.kinds, options.points, options.overlap):
            assert row["rate"] is None or math.isfinite(row["rate"])
            print(json.dumps(row), file=file, flush=True)
            print(json.dumps({**row, "errors": None}), flush=True)


if __name__ == "__main__":
    main()
