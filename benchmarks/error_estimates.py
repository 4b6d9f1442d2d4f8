"""How often the error estimates of the certificate are at least the true errors, on random problems.

Every problem is a random function with one of three monitors, on one of three grids. The true algebraic error is the
distance from the mesh that is solved to rounding; the true error of the grid is the distance of that one from the mesh
on a grid four times as fine, at the nodes that both have. Only problems that are solved strictly on all grids count.

    python benchmarks/error_estimates.py --seed 2 --count 200
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from random_functions import random_functions

import equimesh as em

GRIDS = ((25, 25), (33, 33), (41, 25))
REFINEMENT = 4
RADIUS = 0.03
"""Smoothing of the metrics; without it more problems are relaxed."""


class Ratios(NamedTuple):
    """A problem, and its true errors over the estimated ones; not finite where there is no estimate."""

    name: str
    algebraic: float
    discretization: float


def monitors(u: em.Expression) -> list[em.Monitor]:
    """The monitors that take turns."""
    return [
        em.ArcLength(u=u),
        em.Smoothed(monitor=em.ArcLength(u=u), radius=RADIUS),
        em.Smoothed(monitor=em.Curvature(u=u), radius=RADIUS),
    ]


def ratios(seed: int, count: int) -> Iterator[Ratios]:
    """The ratios of ``count`` problems; problems that are not solved strictly are left out."""
    found, drawn = 0, 2 * count
    for number, function in enumerate(random_functions(seed, drawn)):
        monitor = monitors(em.Expression(function.u))[number % 3]
        n_xi, n_eta = GRIDS[number // 3 % 3]
        one = measured(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n_xi, n_eta=n_eta)), function.kind)
        if one is not None:
            found += 1
            yield one
        if found == count:
            return


def measured(problem: em.Problem, kind: str) -> Ratios | None:
    """The ratios of one problem; ``None`` where it is not solved strictly."""
    grid = problem.grid
    fine = em.Grid(n_xi=REFINEMENT * (grid.n_xi - 1) + 1, n_eta=REFINEMENT * (grid.n_eta - 1) + 1)
    rough = em.solve(problem, allow_relaxed=False, check=False, threads=1)
    if rough.status is not em.Status.CONVERGED:
        return None
    cases = (em.Problem(monitor=problem.monitor, grid=one) for one in (grid, fine))
    tight, finer = (em.solve(case, mode="tight", allow_relaxed=False, check=False, threads=1) for case in cases)
    if not tight.status is finer.status is em.Status.CONVERGED:
        return None
    every = slice(None, None, REFINEMENT)
    shared = em.Mesh(finer.reference.x[every, every], finer.reference.y[every, every])
    return Ratios(
        f"{kind}, {type(problem.monitor).__name__}, {grid}",
        ratio(distance(rough.reference, tight.reference), rough.algebraic_error),
        ratio(distance(tight.reference, shared), rough.discretization_error),
    )


def distance(one: em.Mesh, other: em.Mesh) -> float:
    """The largest difference of a coordinate."""
    return float(max(np.abs(one.x - other.x).max(), np.abs(one.y - other.y).max()))


def ratio(true: float, estimate: float | None) -> float:
    """The true error over the estimate: above 1 the estimate is too small. Errors below 1e-12 are rounding."""
    if estimate is None:
        return np.nan
    return max(true - 1e-12, 0.0) / estimate if estimate > 0.0 else float(true > 1e-10)


def told(name: str, values: np.ndarray) -> str:
    """One line of the report."""
    known = values[np.isfinite(values)]
    parts = ", ".join(f"{q} % below {np.percentile(known, q):.2f}" for q in (50, 90, 95, 99))
    safe = 100 * np.mean(known <= 1.0)
    return f"{name}: {known.size} estimates, {safe:.1f} % on the safe side; true over estimated: {parts}"


def main() -> None:
    """Print the shares on the safe side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--count", type=int, default=200)
    options = parser.parse_args()
    found = list(ratios(options.seed, options.count))
    print(f"{len(found)} problems of seed {options.seed}, solved strictly")
    print(told("algebraic_error", np.array([one.algebraic for one in found])))
    print(told("discretization_error", np.array([one.discretization for one in found])))
    worst = sorted(found, key=lambda one: -np.nan_to_num(max(one.algebraic, one.discretization)))[:8]
    for one in worst:
        print(f"  {one.name}: {one.algebraic:.2f}, {one.discretization:.2f}")


if __name__ == "__main__":
    main()
