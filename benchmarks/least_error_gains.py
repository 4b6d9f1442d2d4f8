"""What least error gains over the uniform mesh and what it costs, by quadrature that is independent of the solver."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from costs.quadrature import Array, errors
from costs.rows import Row, cpu_seconds
from least_error_goals import COSTS, CURVED, LAYERS, POINTS, ROUGH, Goal
from random_functions import RandomFunction, random_functions

import equimesh as em

GAUSS_POINTS = 12
"""Gauss points a direction of every cell."""
RUNS = {65: 5, 257: 3, 1025: 1}
"""Times that a solve is timed, by points a side; the median counts."""
GAIN_RUNS = 3
"""Times that a solve is timed next to its gain."""
WARM_POINTS = 17
"""Points a side of the solve that loads the kernels."""
MIN_GAIN = 1.0 - 1e-9
"""A gain below this is worse than the uniform mesh: less is rounding."""


class Gains(NamedTuple):
    """Error on the uniform mesh over that on the adapted one, in L2 and in H1."""

    l2: float
    h1: float


def measure(u: em.Expression, mesh: em.Mesh) -> Gains:
    """The gains of a mesh of the unit square."""
    uniform = em.Mesh.uniform(mesh.grid)

    def exact(x: Array, y: Array) -> tuple[Array, ...]:
        return u.evaluate(x, y, order=1)

    with np.errstate(all="ignore"):
        before = errors(uniform.points, uniform.cells, exact, GAUSS_POINTS)
        after = errors(mesh.points, mesh.cells, exact, GAUSS_POINTS)
    l2, h1 = (a / b if b > 0.0 else math.inf for a, b in zip(before, after, strict=True))
    return Gains(l2, h1)


def solve(monitor: em.Monitor, n: int) -> em.Solution:
    """The mesh of a monitor on ``n`` x ``n`` points, on one thread."""
    return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)), threads=1, check=False)


def gains(n: int, names: Sequence[str]) -> Iterator[Row]:
    """The L2 gain of every function, with defaults, with little smoothness and by ``auto``; H1 gains are notes."""
    for name in names:
        goal = {**CURVED, **LAYERS}[name]
        goal = goal if n == POINTS else Goal(goal.u)  # goals are for this size
        u = em.Expression(goal.u)
        kinds: dict[str, tuple[em.Monitor, float | None]] = {
            "defaults": (em.LeastError(u=u), goal.default),
            f"smoothness {ROUGH:g}": (em.LeastError(u=u, smoothness=ROUGH), goal.rough),
            "auto": (em.Auto(u=u, purpose="interpolation"), None),
        }
        for kind, (monitor, least) in kinds.items():
            yield _gain(f"{name}, {kind}", u, monitor, n, least)
        found = measure(u, solve(em.LeastError(u=u, norm="h1"), n).mesh)
        yield Row(what=f"{name}, H1 gain with norm h1", value=found.h1, unit="", note=f"L2 {found.l2:.3g}")


def _gain(what: str, u: em.Expression, monitor: em.Monitor, n: int, least: float | None) -> Row:
    seconds, solution = cpu_seconds(lambda: solve(monitor, n), runs=GAIN_RUNS)
    found = measure(u, solution.mesh)
    note = f"H1 {found.h1:.3g}; {1e6 * seconds / n**2:.0f} us/point"
    if not solution.status.succeeded:
        note += f"; {solution.status}"
    return Row(what=what, value=found.l2, unit="", goal=least, at_least=True, note=note)


def costs(sizes: Sequence[int], functions: dict[str, Goal] = CURVED) -> Iterator[Row]:
    """Microseconds of CPU time for a point, with defaults: the median of all functions."""
    for n in sizes:
        found = {name: _cost(em.Expression(goal.u), n) for name, goal in functions.items()}
        slowest = max(found, key=found.__getitem__)
        note = f"{min(found.values()):.1f} to {found[slowest]:.1f}, {slowest} the most"
        yield Row(
            what=f"n = {n}, defaults, median", value=median(found.values()), unit="us/pt", goal=COSTS.get(n), note=note
        )


def _cost(u: em.Expression, n: int) -> float:
    solve(em.LeastError(u=u), WARM_POINTS)
    seconds, _ = cpu_seconds(lambda: solve(em.LeastError(u=u), n), runs=RUNS.get(n, 1))
    return 1e6 * seconds / n**2


def unseen(seed: int, count: int, n: int) -> Iterator[Row]:
    """Random functions: how many meshes are worse than the uniform one, folded, or not made; and the mean gain."""
    kinds: dict[str, tuple[str, Callable[[em.Expression], em.Monitor]]] = {
        "norm l2": ("l2", lambda u: em.LeastError(u=u)),
        "norm h1": ("h1", lambda u: em.LeastError(u=u, norm="h1")),
        "auto": ("l2", lambda u: em.Auto(u=u, purpose="interpolation")),
    }
    functions: list[RandomFunction] = random_functions(seed, count)
    for kind, (norm, monitor) in kinds.items():
        found: list[Gains] = []
        worse: list[str] = []
        failed, folded = Counter[str](), []
        for number, function in enumerate(functions):
            u = em.Expression(function.u)
            try:
                mesh = solve(monitor(u), n).mesh
            except Exception as error:
                failed[type(error).__name__] += 1
                continue
            if mesh.is_folded:
                folded.append(number)
                continue
            found.append(measure(u, mesh))
            gain = getattr(found[-1], norm)
            if gain < MIN_GAIN:
                worse.append(f"{number} ({function.kind}, {gain:.3g})")
        what = f"{count} random functions, {kind}"
        yield Row(what=f"{what}: gain below 1 in {norm.upper()}", value=len(worse), unit="", goal=0, note=_few(worse))
        yield Row(what=f"{what}: folded", value=len(folded), unit="", goal=0, note=_few([str(n) for n in folded]))
        raised = [f"{name}: {times}" for name, times in failed.items()]
        yield Row(what=f"{what}: exceptions", value=failed.total(), unit="", goal=0, note=_few(raised))
        for one in Gains._fields:
            yield _mean(f"{what}: geometric mean {one.upper()} gain", [getattr(each, one) for each in found])


def _mean(what: str, gains: list[float]) -> Row:
    if not gains:
        return Row(what=what, value=math.nan, unit="")
    note = f"smallest {min(gains):.3g}, median {median(gains):.3g}"
    return Row(what=what, value=math.exp(float(np.mean(np.log(gains)))), unit="", note=note)


def _few(items: list[str]) -> str:
    return ", ".join(items[:5]) + (f" and {len(items) - 5} more" if len(items) > 5 else "")
