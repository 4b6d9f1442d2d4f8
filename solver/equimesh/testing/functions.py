"""Functions on which the kits are run, and the order at which Taylor remainders fall."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from equimesh.numerics.types import Array

# Taylor remainders: the check of a derivative.

STEP = 1e-4  # the larger step, in units of the size of the problem
ACCURACY = 1e-6  # of a derivative, as a share of its scale


def wrong_by(value: Callable[[float], Array], slope: Array, size: float = 1.0) -> Array:
    """The distance of ``slope`` from the derivative of ``value`` at 0, entry by entry; 0 where the two agree.

    Their difference is ``r(h) / h``, with ``r(h) = (value(h) - value(-h)) / 2 - h slope`` the odd part of the Taylor
    remainder. It falls at second order in h to the error of the slope. Two values of h, ``STEP * size`` and half of it,
    show how large the part is that falls. Only an excess over that part is reported, so that no error is reported for a
    steep function, or one with a kink near a point.
    """
    coarse, fine = ((value(h) - value(-h)) / (2.0 * h) - slope for h in (STEP * size, 0.5 * STEP * size))
    scale = np.abs(slope).max(initial=0.0) + np.abs(value(0.0)).max(initial=0.0) / size
    error = np.abs(fine - (coarse - fine) / 3.0)
    return np.where(error > np.abs(coarse - fine) + ACCURACY * scale, error, 0.0)


Function: TypeAlias = Callable[[Array, Array], tuple[Array, ...]]

SHAPES = ((), (0,), (7,), (3, 4), (2, 1, 5))
# Of the largest value: a part of an array may be computed by other instructions than the whole.
ROUNDING = 1e-11


def require(kept: bool, sentence: str) -> None:
    """Raise :class:`AssertionError` with ``sentence`` where a promise is not kept."""
    if not kept:
        raise AssertionError(sentence)


def check_function(function: Function, name: str, parts: Sequence[str], points: tuple[Array, Array]) -> None:
    """Check that ``function`` gives one array for each of ``parts``, in the shape of its points and point by point.

    It must not write into its arguments and must repeat itself. ``points`` are flat arrays.
    """
    x, y = points
    for shape in SHAPES:
        count = int(np.prod(shape))
        results = function(x[:count].reshape(shape), y[:count].reshape(shape))
        require(
            isinstance(results, tuple) and len(results) == len(parts),
            f"{name} must return the tuple ({', '.join(parts)}), not {_describe(results)}",
        )
        for part, result in zip(parts, results, strict=True):
            require(np.shape(result) == shape, f"{name}: {part} has shape {np.shape(result)} at points of {shape}")
    given = x.copy(), y.copy()
    whole = function(*given)
    require(
        all(np.array_equal(now, before) for now, before in zip(given, points, strict=True)),
        f"{name} writes into its arguments",
    )
    _require_equal(whole, function(x, y), f"{name} does not repeat itself", parts, points)
    backwards = tuple(part[::-1] for part in function(x[::-1].copy(), y[::-1].copy()))
    _require_equal(whole, backwards, f"{name} depends on the order of the points", parts, points)
    half = x.size // 2
    halves = [function(x[cut], y[cut]) for cut in (slice(half), slice(half, None))]
    joined = tuple(np.concatenate(pair) for pair in zip(*halves, strict=True))
    _require_equal(whole, joined, f"{name} of some of the points differs from that of all", parts, points)


def check_derivative(
    value: Callable[[Array, Array], Array],
    slopes: tuple[Array, Array],
    names: tuple[str, str],
    points: tuple[Array, Array],
    size: float,
) -> None:
    """Check that ``slopes`` are the derivatives of ``value`` by its two arguments, by their Taylor remainders."""
    x, y = points
    for slope, name, (along_x, along_y) in zip(slopes, names, ((1.0, 0.0), (0.0, 1.0)), strict=True):

        def moved(h: float, along_x: float = along_x, along_y: float = along_y) -> Array:
            return value(x + h * along_x, y + h * along_y)

        wrong = wrong_by(moved, slope, size)
        worst = int(wrong.argmax())
        require(
            wrong[worst] == 0.0,
            f"{name} = {slope[worst]:.6g} is wrong by {wrong[worst]:.3g} at {place(points, worst)}: the Taylor"
            " remainder does not fall at second order",
        )


def place(points: tuple[Array, Array], k: int) -> str:
    """Point number ``k`` of flat arrays, for a message."""
    return f"({points[0][k]:.6g}, {points[1][k]:.6g})"


def require_finite(values: Sequence[Array], name: str, parts: Sequence[str], points: tuple[Array, Array]) -> None:
    """Raise at the first value that is not finite."""
    for part, value in zip(parts, values, strict=True):
        bad = ~np.isfinite(value)
        require(not bad.any(), f"{name}: {part} is not finite at {place(points, int(bad.argmax()))}")


def _require_equal(
    values: Sequence[Array], others: Sequence[Array], what: str, parts: Sequence[str], points: tuple[Array, Array]
) -> None:
    for part, value, other in zip(parts, values, others, strict=True):
        differences = np.nan_to_num(np.abs(value - other))
        worst = int(differences.argmax())
        require(
            differences[worst] <= ROUNDING * np.nan_to_num(np.abs(value)).max(),
            f"{what}: {part} differs by {differences[worst]:.3g} at {place(points, worst)}",
        )


def _describe(results: object) -> str:
    return f"{len(results)} values" if isinstance(results, tuple) else type(results).__name__
