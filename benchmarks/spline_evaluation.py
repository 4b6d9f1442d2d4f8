"""Times of a bicubic spline at scattered points: the compiled loops of equimesh next to SciPy's ``NdBSpline``.

    python benchmarks/spline_evaluation.py

Each row: coefficients, points, order of the derivatives, milliseconds of both, their quotient, and the largest relative
difference of their results. A time is the shortest of five runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.interpolate import NdBSpline, RectBivariateSpline

from equimesh.fields.bicubic import COUNT, Bicubic
from equimesh.numerics.types import Array

PARTIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
RUNS = 5


def timed(work: Callable[[], tuple[Array, ...]]) -> tuple[float, tuple[Array, ...]]:
    """Milliseconds of the shortest of some runs, after one that compiles; and the result."""
    result, times = work(), []
    for _ in range(RUNS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1000.0 * min(times), result


def compare(n: int, points: int, order: int) -> str:
    """One row of the table."""
    axis = np.linspace(0.0, 1.0, n)
    values = np.tanh(20.0 * np.add.outer((axis - 0.5) ** 2, (axis - 0.5) ** 2) - 2.0)
    own = Bicubic.of(RectBivariateSpline(axis, axis, values, s=0))
    scipys = NdBSpline(own.knots, own.coefficients, 3)
    x, y = np.random.default_rng(1).random((2, points))
    both = np.column_stack([x, y])
    first, mine = timed(lambda: own.evaluate(x, y, order))
    second, theirs = timed(lambda: tuple(scipys(both, nu=nu) for nu in PARTIALS[: COUNT[order]]))
    difference = max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(mine, theirs, strict=True))
    return f"{n:4d}^2 {points:12,d} {order:6d} {first:10.2f} {second:10.2f} {second / first:9.1f} {difference:11.0e}"


def main() -> None:
    """Print the table."""
    print("coefficients  points  order   equimesh  NdBSpline  quotient  difference")
    for n in (65, 257):
        for points in (4_096, 65_536, 1_048_576):
            for order in range(3):
                print(compare(n, points, order), flush=True)


if __name__ == "__main__":
    main()
