"""Least error on ten geometries of blocks against its goals: gains, cost, folds, angles, a singular corner, a million.

python benchmarks/geometry.py                # quick: few functions, small meshes
python benchmarks/geometry.py --full         # 40 functions on each geometry, at 33,000 and 140,000 nodes: hours
python benchmarks/geometry.py --parts gains --nodes 33000 --count 8    # one part of it, with fewer functions
"""

from __future__ import annotations

import argparse
import math
import os
import re
import time
from collections.abc import Iterator
from typing import NamedTuple

from equimesh_cli.report import THREAD_COUNTS

if __name__ == "__main__":
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))  # before the linear algebra is loaded

import numpy as np
from costs.rows import Row, lines
from random_functions import random_functions

import equimesh as em
from equimesh.quality.measures import measure_errors
from equimesh.rounds.shape import counts_within
from equimesh.testing import geometries

GEOMETRIES = (
    *("l_shape", "step", "obstacle", "plus", "ring", "disc", "cylinder", "naca0012_o", "naca0012_c", "pitz_daily"),
)
"""Functions of :mod:`equimesh.testing.geometries`."""
FRONTS = ("front", "ring", "star", "wave", "arc", "upright", "level")
"""Kinds of the random functions that are taken: those with a front, which is what meshes are adapted to."""
WINDOWS = {"naca0012_o": (-0.5, -1.0, 2.0), "naca0012_c": (-0.5, -1.0, 2.0)}
"""Where the unit square of the random functions lies: left, bottom and side; elsewhere in the middle of the box."""
SINGULAR = "(x**2 + y**2)**(1/3)"
"""r to the power 2/3 at the re-entrant corner of the L: as smooth as a solution is there."""
GAINS = 12.0
"""The geometric mean of the L2 gains that is the goal."""
COSTS = {33_000: 15.0, 140_000: 8.0}
"""Microseconds of CPU a point that are the goals, by nodes."""
GAUSS_POINTS = 4
"""Gauss points a direction and cell of the measured errors."""
BOUND = 60.0
"""Degrees of non-orthogonality: corners then lie between 30 and 150 degrees."""
MILLION = 1_000_000
BUDGET = 1000
"""Points of the meshes whose counts are chosen."""
BUDGETS = {
    "peak in one of four blocks": ("four", "exp(-200*((x - 0.3)**2 + (y - 0.3)**2))"),
    "layer": ("four", "exp(-30*x)"),
    "hole in a channel": ("cylinder", "exp(-8*(sqrt(x**2 + y**2) - 0.5))"),
    "corner of the L": ("l_shape", SINGULAR),
}
"""Domains and solutions for which counts are chosen."""
PARTS = ("gains", "angles", "corner", "budget", "million")
"""Parts of the report: gains and costs, angles within bounds, a singular corner, chosen counts, a million nodes."""


class Solved(NamedTuple):
    """One function on one geometry."""

    gain: float
    microseconds: float
    folded: bool
    within: float
    """The share of corners between 30 and 150 degrees."""


def functions(domain: em.Blocks, name: str, seed: int, count: int) -> Iterator[em.Expression]:
    """Random fronts on a square of the domain."""
    (x0, x1), (y0, y1) = domain.box
    side = min(x1 - x0, y1 - y0)
    left, bottom, side = WINDOWS.get(name, (0.5 * (x0 + x1 - side), 0.5 * (y0 + y1 - side), side))
    kept = 0
    for function in random_functions(seed, 10 * count):
        if function.kind in FRONTS and kept < count:
            kept += 1
            u = re.sub(r"\bx\b", f"((x - ({left:.6g}))/{side:.6g})", function.u)
            yield em.Expression(re.sub(r"\by\b", f"((y - ({bottom:.6g}))/{side:.6g})", u))


def solve(domain: em.Blocks, u: em.Expression, bound: float | None = None, *, auto: bool = False) -> Solved:
    """The measures of one mesh, with errors by Gauss points of the benchmark; ``auto`` compares weights."""
    monitor = em.Auto(u=u) if auto else em.LeastError(u=u, orthogonality=bound)
    problem = em.Problem(monitor=monitor, domain=domain)
    began = time.process_time()
    solution = em.solve(problem, threads=1, check=False)
    seconds = time.process_time() - began
    with np.errstate(all="ignore"):
        errors = measure_errors(solution.mesh, u, uniform=domain.mesh, gauss=GAUSS_POINTS)
    gain = math.nan if errors is None else errors.l2_uniform / errors.l2
    return Solved(gain, 1e6 * seconds / domain.points, solution.mesh.is_folded, solution.angles.share_within)


def mean(values: list[float]) -> float:
    """The geometric mean."""
    return math.exp(sum(map(math.log, values)) / len(values))


def gains(nodes: int, count: int, seed: int, bound: float | None = None) -> Iterator[Row]:
    """The gains on every geometry and on all of them, next to the goals."""
    found: list[Solved] = []
    for name in GEOMETRIES:
        domain = getattr(geometries, name)(nodes)
        here = [solve(domain, u, bound) for u in functions(domain, name, seed, count)]
        note = f"smallest {min(one.gain for one in here):.3g}; {np.mean([one.microseconds for one in here]):.3g} us"
        note += f"; {100 * np.mean([one.within for one in here]):.1f} % of corners within 30 to 150 degrees"
        yield Row(what=f"{name}, {domain.points} nodes", value=mean([one.gain for one in here]), unit="", note=note)
        found += here
    yield Row(what="all, L2 gain", value=mean([one.gain for one in found]), unit="", goal=GAINS, at_least=True)
    cost = float(np.mean([one.microseconds for one in found]))
    yield Row(what="all, CPU with measures", value=cost, unit="us a point", goal=COSTS.get(nodes))
    yield Row(what="folded", value=sum(one.folded for one in found), unit="", goal=0)
    yield Row(what="worse than the initial mesh", value=sum(one.gain < 1.0 for one in found), unit="", goal=0)
    yield Row(what="corners within 30 to 150 degrees", value=100 * np.mean([one.within for one in found]), unit="%")


def bounded(nodes: int, count: int, seed: int) -> Iterator[Row]:
    """What a bound of the angles costs, and how many corners are within the limits then."""
    shares: list[float] = []
    within: list[float] = []
    for name in GEOMETRIES:
        domain = getattr(geometries, name)(nodes)
        for u in functions(domain, name, seed, count):
            limited = solve(domain, u, BOUND)
            shares.append(limited.gain / solve(domain, u).gain)
            within.append(limited.within)
    yield Row(what=f"gain within {BOUND:g} degrees, share", value=mean(shares), unit="", goal=0.75, at_least=True)
    yield Row(what="corners within 30 to 150", value=100 * float(np.mean(within)), unit="%", goal=99.0, at_least=True)


def corner(nodes: int) -> Iterator[Row]:
    """The gain for the singular function of a re-entrant corner, with the usual weights and those of ``Auto``."""
    domain, u = geometries.l_shape(nodes), em.Expression(SINGULAR)
    found = solve(domain, u)
    yield Row(what="r^(2/3) on the L, LeastError", value=found.gain, unit="", note=f"{found.microseconds:.3g} us")
    found = solve(domain, u, auto=True)
    note = f"{found.microseconds:.3g} us; folded: {found.folded}"
    yield Row(what="r^(2/3) on the L, Auto", value=found.gain, unit="", goal=30.0, at_least=True, note=note)


def four(nodes: int) -> em.Blocks:
    """The unit square in four blocks of about so many nodes together."""
    cells = round((math.sqrt(nodes) - 1) / 2)
    places = {f"{i}{j}": [i / 2, j / 2] for i in range(3) for j in range(3)}
    corners = [[f"{i}{j}", f"{i + 1}{j}", f"{i + 1}{j + 1}", f"{i}{j + 1}"] for i in range(2) for j in range(2)]
    return em.Blocks.of({"vertices": places, "blocks": [{"corners": one, "cells": [cells] * 2} for one in corners]})


def budget(points: int) -> Iterator[Row]:
    """How many times smaller errors are where a loop chooses the counts, than with those of the domain."""
    for what, (name, formula) in BUDGETS.items():
        u = em.Expression(formula)
        domain = four(points) if name == "four" else getattr(geometries, name)(points)
        usual = domain.with_counts(counts_within(points, domain))
        for norm in ("l2", "h1"):

            def solver(mesh: em.Mesh, u: em.Expression = u) -> np.ndarray:
                return u.evaluate(mesh.x, mesh.y)[0]

            kept = em.adapt(solver, domain=usual, norm=norm, threads=1)
            chosen = em.adapt(solver, domain=domain, points=points, norm=norm, threads=1)
            found = [measure_errors(one.mesh, u, uniform=one.mesh, gauss=GAUSS_POINTS) for one in (kept, chosen)]
            before, after = (math.nan if one is None else getattr(one, norm) for one in found)
            sizes = " and ".join(str(len(one.mesh.points)) for one in (kept, chosen))
            counts = domain.with_counts_of(chosen.mesh).layout.counts
            note = f"{sizes} points; cells {usual.layout.counts.tolist()}, chosen {counts.tolist()}"
            yield Row(what=f"{what}, {norm.upper()}", value=before / after, unit="", note=note)


def million(nodes: int) -> Iterator[Row]:
    """A large mesh on two threads, twice."""
    domain = geometries.l_shape(nodes)
    u = next(functions(domain, "l_shape", 5, 1))
    for run in (1, 2):
        began, at_first = time.perf_counter(), time.process_time()
        em.solve(em.Problem(monitor=em.LeastError(u=u), domain=domain), threads=2, check=False)
        seconds, cpu = time.perf_counter() - began, time.process_time() - at_first
        what, goal = f"{domain.points} nodes on two threads, run {run}", 3.0 if nodes == MILLION else None
        yield Row(what=what, value=seconds, unit="s", goal=goal, note=f"CPU time {cpu:.3g} s")


def report(options: argparse.Namespace) -> Iterator[Row]:
    """All rows of the parts that are asked for."""
    sizes = tuple(COSTS) if options.full else options.nodes
    count = options.count or (40 if options.full else 2)
    solve(geometries.l_shape(1000), em.Expression("tanh(9*x)"))  # loads the kernels
    if "gains" in options.parts:
        for nodes in sizes:
            yield from gains(nodes, count, options.seed)
    if "angles" in options.parts:
        yield from bounded(min(8000, min(sizes)), max(1, count // 4), options.seed)
    if "corner" in options.parts:
        yield from corner(12_000)
    if "budget" in options.parts:
        yield from budget(BUDGET)
    if "million" in options.parts:
        yield from million(MILLION if max(sizes) >= min(COSTS) else 20 * max(sizes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="40 functions, 33,000, 140,000 and a million nodes")
    parser.add_argument("--nodes", type=int, nargs="+", default=[4000], help="nodes of the meshes")
    parser.add_argument("--count", type=int, help="functions on each geometry; a quarter of them to bound angles")
    parser.add_argument("--seed", type=int, default=17, help="of the random functions")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to measure")
    for line in lines(report(parser.parse_args())):
        print(line, flush=True)


if __name__ == "__main__":
    main()
