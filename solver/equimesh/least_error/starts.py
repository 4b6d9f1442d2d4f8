"""Meshes to start from: the uniform one, and the best rectilinear ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from equimesh.domains.domain import Domain
from equimesh.fields.field import Field
from equimesh.least_error.elements import Norm
from equimesh.numerics.types import Array

MAX_PASSES = 8
"""Passes of one-dimensional equidistribution; layers of a thousandth of the domain are found within them."""
MIN_CHANGE_CELLS = 0.05
"""Largest move of a line, in spacings, at which the passes end."""
MAX_CROSSINGS = 33
"""Lines of the other family, at most, over which the mean is taken."""
EXPONENTS = {"l2": 0.2, "h1": 1.0 / 3.0}
"""The power of the integral of the squared second derivative that is the density of lines with the least error."""
INSET_SHARE = 0.1
"""The share of a spacing by which lines are moved from a side where u has no finite slope."""
ENDS = 4
"""Lines of a closed family that are repeated at either end, so that interpolation goes on there."""
BISECTIONS = 60
"""Halvings of the range in which the beginning of a closed family is sought: to rounding."""
ROUNDING_SHARE = 1e-13
"""The share of the largest derivative of u that counts as rounding in a derivative, or in its change."""


class Patch(NamedTuple):
    """A piece of a domain that two families of straight lines cross: a grid, or a block."""

    places: Callable[[Array, Array], Sequence[Array]]
    """``x, y, x_s, x_t, y_s, y_t`` at arrays of s and t, the positions of lines from 0 to 1."""
    families: tuple[int, int] = (0, 1)
    """The numbers of the families of lines of constant s, and of constant t."""
    turned: tuple[bool, bool] = (False, False)
    """Whether the positions of the lines of each family run the other way."""
    share: float = 1.0
    """Its share of the domain."""


def equidistributed(
    u: Field,
    patches: Sequence[Patch],
    counts: Sequence[int],
    norm: Norm,
    floor: float,
    closed: Sequence[bool] | None = None,
) -> list[Array] | None:
    """The positions, 0 to 1, of ``counts`` lines of each family, of a mesh whose lines are straight on every patch.

    Each family is equidistributed in the density of least error of piecewise linear interpolation, for the mean over
    the lines that cross it: the integral of ``u_ss^2`` to the power 1/5 in L2, 1/3 in H1, smoothed over neighbours.
    ``floor`` times its mean is added: more of it leaves more lines where u is flat. The lines of a ``closed`` family
    go on after a turn; their mean position is that of uniform ones, so that it does not matter where they begin.
    ``None`` where u is not finite.
    """
    closed = closed or [False] * len(counts)
    lines = [np.linspace(0.0, 1.0, count) for count in counts]
    for _ in range(MAX_PASSES):
        few = [
            resampled(line, min(line.size, MAX_CROSSINGS), closed=is_closed)
            for line, is_closed in zip(lines, closed, strict=True)
        ]
        found: list[list[tuple[Array, Array]]] = [[] for _ in lines]
        for patch in patches:
            for axis, slopes in enumerate(_along(u, patch, lines, few)):
                family = patch.families[axis]
                if not np.isfinite(slopes).all():
                    return None
                across = patch.families[1 - axis]
                shares = patch.share * _shares(few[across], closed[across])
                found[family].append((slopes, shares[::-1] if patch.turned[1 - axis] else shares))
        moved = [
            _equidistributed(line, *_together(crossed), EXPONENTS[norm], floor, is_closed)
            for line, crossed, is_closed in zip(lines, found, closed, strict=True)
        ]
        change = max(_change(line, new) for line, new in zip(lines, moved, strict=True))
        lines = moved
        if change < MIN_CHANGE_CELLS:
            break
    return lines


def rectilinear(
    u: Field,
    domain: Domain,
    counts: tuple[int, int],
    norm: Norm,
    floor: float,
    *,
    closed: tuple[bool, bool] = (False, False),
) -> tuple[Array, Array] | None:
    """The positions of ``counts`` lines along s and along t of a grid, as :func:`equidistributed` finds them."""

    def places(s: Array, t: Array) -> Sequence[Array]:
        return *domain.map(s, t), *domain.jacobian(s, t)

    found = equidistributed(u, [Patch(places)], counts, norm, floor, closed)
    return None if found is None else (found[0], found[1])


def _together(crossed: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Slopes along one family, and the shares of the crossings, of several patches."""
    if len(crossed) == 1:
        return crossed[0]
    slopes, shares = zip(*crossed, strict=True)
    return np.concatenate(slopes, axis=1), np.concatenate(shares)


def _along(u: Field, patch: Patch, lines: Sequence[Array], few: Sequence[Array]) -> tuple[Array, Array]:
    """The derivatives of u along both families of a patch where ``few`` lines of the other cross: ``(lines, few)``."""
    (s, few_s), (t, few_t) = (
        [1.0 - at[family][::-1] if is_turned else at[family] for at in (lines, few)]
        for family, is_turned in zip(patch.families, patch.turned, strict=True)
    )
    along_s, along_t = _finite_slopes(u, patch, s, few_t)
    if s.size > few_s.size or t.size > few_t.size:
        along_t = _finite_slopes(u, patch, few_s, t)[1]
    along_t = along_t.T
    return -along_s[::-1] if patch.turned[0] else along_s, -along_t[::-1] if patch.turned[1] else along_t


def product(s: Array, t: Array) -> Array:
    """The mesh of straight lines, shape ``(2, nodes)``."""
    return np.stack([q.reshape(-1) for q in np.meshgrid(s, t, indexing="ij")])


def resampled(line: Array, count: int, *, closed: bool = False) -> Array:
    """The positions of ``count`` lines, by monotone interpolation of those in ``line``; it may be a closed family."""
    if line.size == count:
        return line
    at = np.linspace(0.0, line.size - 1.0, count)
    if line.size == 2:
        return at
    if closed:
        number = np.arange(-ENDS, line.size + ENDS)
        turns, node = np.divmod(number, line.size - 1)
        return np.asarray(PchipInterpolator(number, line[node] + turns)(at))
    return np.asarray(PchipInterpolator(np.arange(line.size), line)(at))


def _shares(line: Array, closed: bool) -> Array:
    """The length that each line stands for, in a mean over the family."""
    if not closed:
        return np.gradient(line)
    steps = np.diff(line)
    return np.append(0.5 * (steps + np.roll(steps, 1)), 0.0)


def _finite_slopes(u: Field, patch: Patch, s: Array, t: Array) -> tuple[Array, Array]:
    """The derivatives of u by s and by t; from points next to the sides where they are infinite on these."""
    slopes = _slopes(u, patch, s, t)
    return slopes if np.isfinite(slopes).all() else _slopes(u, patch, _inset(s), _inset(t))


def _inset(line: Array) -> Array:
    """The line with its ends moved inwards by a small share of their spacings."""
    inset = line.copy()
    inset[0] += INSET_SHARE * (line[1] - line[0])
    inset[-1] -= INSET_SHARE * (line[-1] - line[-2])
    return inset


def _slopes(u: Field, patch: Patch, s: Array, t: Array) -> tuple[Array, Array]:
    """The derivatives of u by s and by t at the crossings of the lines, 0 where they are nothing but rounding."""
    x, y, x_s, x_t, y_s, y_t = patch.places(*np.meshgrid(s, t, indexing="ij"))
    _, u_x, u_y = u.evaluate(x, y, order=1)
    return _sum(u_x * x_s, u_y * y_s), _sum(u_x * x_t, u_y * y_t)


def _sum(one: Array, other: Array) -> Array:
    """The sum, 0 where it is nothing but rounding."""
    both = one + other
    smallest = ROUNDING_SHARE * np.maximum(np.abs(one), np.abs(other)).max()
    return np.where(np.isfinite(both) & (np.abs(both) <= smallest), 0.0, both)


def _equidistributed(line: Array, slopes: Array, shares: Array, exponent: float, floor: float, closed: bool) -> Array:
    """The line moved to equal integrals of its density; second derivatives are differences of ``slopes``.

    ``shares`` are the lengths for which the lines of the other family stand.
    """
    steps, changes = np.diff(line), np.diff(slopes, axis=0)
    changes[np.abs(changes) <= ROUNDING_SHARE * np.abs(slopes).max()] = 0.0
    bends = changes / steps[:, None]
    size = float(np.abs(bends).max())
    if not size > 0.0:
        return line
    density = ((bends / size) ** 2 @ shares) ** exponent
    padded = np.pad(density, 1, mode="wrap" if closed else "edge")
    density = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
    density += floor * float(density @ steps)
    integral = np.concatenate([[0.0], np.cumsum(density * steps)])
    if closed:
        return _with_uniform_mean(integral, line)
    moved = np.interp(np.linspace(0.0, integral[-1], line.size), integral, line)
    moved[0], moved[-1] = 0.0, 1.0
    return np.asarray(moved)


def _with_uniform_mean(integral: Array, line: Array) -> Array:
    """A closed family at equal integrals of its density, with the mean position of uniform lines."""
    total, cells = float(integral[-1]), line.size - 1
    knots = np.concatenate([integral[:-1] - total, integral[:-1], integral + total])
    places = np.concatenate([line[:-1] - 1.0, line[:-1], line + 1.0])
    at = np.linspace(0.0, total, line.size)
    low, high = -total, total
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        mean = float(np.interp(at[:-1] + middle, knots, places).mean())
        low, high = (middle, high) if mean < 0.5 * (cells - 1) / cells else (low, middle)
    moved = np.interp(at + low, knots, places)
    moved[-1] = moved[0] + 1.0
    return np.asarray(moved)


def _change(old: Array, new: Array) -> float:
    """The largest move of a line, as a share of the smaller of its spacings."""
    steps = np.diff(old)
    nearest = np.minimum(np.append(steps, steps[-1]), np.append(steps[0], steps))
    return float(np.max(np.abs(new - old) / nearest))
