"""The interpolation error that an amount of CPU time buys, by the mesher.

Every mesher makes meshes of growing size until one takes longer than the largest budget. These give pairs of CPU time
and L2 error. A mesher may use any of its meshes, so its error at a time is the smallest of those that took no longer.
Between two meshes the logarithms are interpolated. After the largest mesh its own error counts.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from statistics import median
from typing import NamedTuple

import equimesh as em
from costs import peers
from costs.peers import Triangles
from costs.quadrature import l2_error

BUDGETS = (0.05, 0.2, 1.0)
"""Seconds of CPU time."""
SIZES = (9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025)
"""Points a side of the meshes that are tried, or the side of as many vertices."""
QUICK_SECONDS = 0.2
"""Meshes that take less are timed several times."""
RUNS = 3
"""Times that a quick mesh is timed; the median counts."""
COARSE_CELLS, COARSE_POINTS, FINE_POINTS = 20_000, 12, 4
"""Meshes of at most so many cells are measured with so many Gauss points a direction; finer meshes with fewer."""


class Bought(NamedTuple):
    """The CPU time of a mesh in seconds, and its L2 error."""

    cpu: float
    l2: float


@dataclass(frozen=True, kw_only=True)
class Curve:
    """The meshes of one mesher for one function."""

    function: str
    mesher: str
    meshes: tuple[Bought, ...]

    def at(self, seconds: float) -> float | None:
        """The error that so many seconds buy; ``None`` where every mesh takes longer."""
        best: list[Bought] = []
        for mesh in sorted(self.meshes):
            if not best or mesh.l2 < best[-1].l2:
                best.append(mesh)
        for before, after in pairwise(best):
            if before.cpu <= seconds <= after.cpu:
                share = math.log(seconds / before.cpu) / math.log(after.cpu / before.cpu)
                return math.exp((1.0 - share) * math.log(before.l2) + share * math.log(after.l2))
        return best[-1].l2 if best and best[-1].cpu <= seconds else None


def curves(
    name: str, u: em.Expression, monitors: dict[str, em.Monitor], budget: float = max(BUDGETS)
) -> Iterator[Curve]:
    """The curve of each of our monitors, and of Mmg2d and Gmsh where they are installed."""
    for kind, monitor in monitors.items():
        yield _curve(name, kind, u, _ours(monitor), budget)
    if peers.is_installed("mmgpy"):
        yield _curve(name, "Mmg2d", u, lambda n: _mmg(u, n), budget)
    if peers.is_installed("gmsh"):
        with peers.gmsh_generator(u) as generate:
            yield _curve(name, "Gmsh", u, lambda n: [_timed(lambda: generate(peers.first_scale(n)))], budget)


def lines(found: Iterable[Curve], budgets: Sequence[float] = BUDGETS) -> Iterator[str]:
    """The lines of a table with a heading, each as soon as all curves of its function are known.

    They have the errors at the budgets; the smallest one is marked. Curves of one function follow each other.
    """
    yield f"{'u':<9}{'mesher':<26}" + "".join(f"{f'{seconds:g} s':>12}" for seconds in budgets)
    for name, curves_of in groupby(found, lambda curve: curve.function):
        group = list(curves_of)
        errors = [[curve.at(seconds) for seconds in budgets] for curve in group]
        least = [min((e for e in column if e is not None), default=None) for column in zip(*errors, strict=True)]
        for curve, row in zip(group, errors, strict=True):
            cells = (_cell(error, best) for error, best in zip(row, least, strict=True))
            yield (f"{name:<9}{curve.mesher:<26}" + "".join(cells)).rstrip()


def _cell(error: float | None, least: float | None) -> str:
    text = "-" if error is None else f"{error:.2e}"
    return f"{text + ('*' if error is not None and error == least else ' '):>12}"


def _curve(
    name: str, mesher: str, u: em.Expression, make: Callable[[int], Iterable[tuple[float, Triangles]]], budget: float
) -> Curve:
    bought: list[Bought] = []
    for n in SIZES:
        slowest = 0.0
        for seconds, (points, cells) in make(n):
            count = COARSE_POINTS if len(cells) <= COARSE_CELLS else FINE_POINTS
            bought.append(Bought(seconds, l2_error(points, cells, lambda x, y: u.evaluate(x, y)[0], count)))
            slowest = max(slowest, seconds)
        if slowest > budget:
            break
    return Curve(function=name, mesher=mesher, meshes=tuple(bought))


def _ours(monitor: em.Monitor) -> Callable[[int], list[tuple[float, Triangles]]]:
    def make(n: int) -> list[tuple[float, Triangles]]:
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n))

        def mesh() -> Triangles:
            found = em.solve(problem, threads=1, check=False).mesh
            return found.points, found.cells

        return [_timed(mesh)]

    make(SIZES[0])  # loads the kernels
    return make


def _mmg(u: em.Expression, n: int) -> Iterator[tuple[float, Triangles]]:
    """The mesh after each pass, with the time of all passes so far."""
    passes, seconds = peers.mmg_passes(u, n, peers.first_scale(n)), 0.0
    while True:
        begun = time.process_time()
        found = next(passes, None)
        seconds += time.process_time() - begun
        if found is None:
            return
        yield seconds, found


def _timed(make: Callable[[], Triangles]) -> tuple[float, Triangles]:
    begun = time.process_time()
    found = make()
    times = [time.process_time() - begun]
    while times[0] < QUICK_SECONDS and len(times) < RUNS:
        begun = time.process_time()
        make()
        times.append(time.process_time() - begun)
    return median(times), found
