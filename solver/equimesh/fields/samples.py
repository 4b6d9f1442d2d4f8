"""u given by samples: values on a rectilinear grid, or at scattered points, made into a smooth function."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from equimesh.domains.domain import UNIT, Box, check_extent, pair
from equimesh.errors import SamplesError
from equimesh.fields.bicubic import Bicubic
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import count_noun, real_array
from equimesh.numerics.types import Array

UNIT_BOX: Box = (UNIT, UNIT)
MIN_CUBIC = 4  # points that a cubic needs
COVERAGE_TOLERANCE = 1e-9  # and what follows: in extents of the box
MAX_BEYOND = 0.5  # a rim of ghost cells is welcome, another domain is a mistake


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class GridSamples:
    """u as the bicubic spline through samples on a rectilinear grid.

    ``values[i, j]``, of shape ``(nx, ny)``, is u at ``(x[i], y[j])``. ``x``, of shape ``(nx,)``, and ``y``,
    of shape ``(ny,)``, increase strictly and cover ``box = ((x0, x1), (y0, y1))``, that of the domain; unless given,
    they reach from 0 or less to 1 or more. For smooth u and spacing h the values are accurate to O(h^4), the gradient
    to O(h^3). With only 2 or 3 points in a direction the spline is linear or quadratic there.

    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index.
    """

    x: Array
    y: Array
    values: Array
    box: Box
    _spline: Bicubic = field(repr=False)

    def __init__(self, *, x: npt.ArrayLike, y: npt.ArrayLike, values: npt.ArrayLike, box: Box | None = None) -> None:
        asked = RequestedBox.of(box)
        axes = {"x": _axis(x, "x"), "y": _axis(y, "y")}
        table = real_array(values, "values", ndim=2)
        shape = (axes["x"].size, axes["y"].size)
        if table.shape != shape:
            hint = "; transpose it" if table.shape == shape[::-1] else ""
            raise SamplesError(
                f"values has shape {table.shape}, but x has {shape[0]} points and y has {shape[1]}:"
                f" values[i][j] is u at (x[i], y[j]), so the shape must be {shape}{hint}",
                field="values",
            )
        for number, (name, axis) in enumerate(axes.items()):
            _check_reach(axis, name, asked, number, ends_of(axes["x"], axes["y"]))
        check_size(table)
        spline = Bicubic.of(_bicubic(axes["x"], axes["y"], table))
        _check_slopes(spline, axes)
        for name, value in {**axes, "values": table, "box": asked.box, "_spline": spline}.items():
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``.

        Outside the samples the nearest point of their rectangle is used.
        """
        return self._spline.evaluate(x, y, order)

    def __repr__(self) -> str:
        return f"GridSamples({self.x.size} x {self.y.size})"


def _axis(value: object, name: str) -> Array:
    """A strictly increasing axis of at least two points."""
    axis = real_array(value, name, ndim=1)
    if axis.size < 2:
        raise SamplesError(
            f"{name} has {count_noun(axis.size, 'point')}: at least 2 are needed in each direction, {MIN_CUBIC} for"
            " a cubic spline",
            field=name,
        )
    steps = np.diff(axis)
    if np.all(steps > 0):
        return axis
    i = int(np.argmax(steps <= 0)) + 1
    if steps[i - 1] == 0:
        what, remedy = "repeats", "leave out the repeated line of samples"
    elif np.all(steps < 0):
        flip = "values[::-1, :]" if name == "x" else "values[:, ::-1]"
        what, remedy = (
            "is less than",
            f"the axis decreases; reverse it and the samples with it: {name}[::-1], {flip}",
        )
    else:
        what, remedy = "is less than", "sort the axis and the samples with it"
    raise SamplesError(
        f"{name}[{i}] = {axis[i]:.6g} {what} {name}[{i - 1}] = {axis[i - 1]:.6g}: the axis must increase; {remedy}",
        field=name,
    )


def _require_box(box: object) -> Box:
    """``box`` as two pairs of floats that increase."""
    if not isinstance(box, (tuple, list)) or len(box) != 2:
        raise SamplesError("box must be ((x0, x1), (y0, y1)), that of the domain", field="box")
    first, second = (pair(ends, "box") for ends in box)
    check_extent(first, "box: x", "box")
    check_extent(second, "box: y", "box")
    return first, second


@dataclass(frozen=True)
class RequestedBox:
    """The box that samples must cover, and whether the caller gave it: a domain's, or the unit square by default."""

    box: Box
    given: bool

    @classmethod
    def of(cls, box: Box | None) -> RequestedBox:
        return cls(UNIT_BOX, given=False) if box is None else cls(_require_box(box), given=True)

    @property
    def region(self) -> str:
        """The box in words."""
        (x0, x1), (y0, y1) = self.box
        return f"box [{x0:.6g}, {x1:.6g}] x [{y0:.6g}, {y1:.6g}] of the domain" if self.given else "unit square"

    @property
    def is_unit(self) -> bool:
        """Whether no other domain can have been meant on purpose."""
        return self.box == UNIT_BOX

    def mapped(self, number: int, low: float, high: float) -> str:
        """How to map an axis of the samples, the first or second, to the unit square."""
        return f"map the coordinates there, ({'xy'[number]} - {low:.6g}) / {high - low:.6g}"

    def instead(self, covered: Box) -> str:
        """The offer of another domain, the rectangle that the samples cover; empty where a domain was given."""
        if not self.is_unit or any(low >= high for low, high in covered):
            return ""
        x, y = (f"({low:.6g}, {high:.6g})" for low, high in covered)
        if self.given:
            return f", or give the domain that they cover, a rectangle with x={x}, y={y}"
        return f", or give the domain, e.g. box=({x}, {y}) here and domain=Rectangle(x={x}, y={y}) in the problem"


def ends_of(x: Array, y: Array) -> Box:
    """The smallest box around samples."""
    return (float(x.min()), float(x.max())), (float(y.min()), float(y.max()))


def _check_reach(axis: Array, name: str, asked: RequestedBox, number: int, covered: Box) -> None:
    """Refuse an axis that leaves a part of the box without samples."""
    low, high = asked.box[number]
    slack = COVERAGE_TOLERANCE * (high - low)
    if axis[0] > low + slack or axis[-1] < high - slack:
        remedy = f"add samples up to {low:.6g} and {high:.6g}"
        if asked.is_unit:
            remedy += f", or {asked.mapped(number, *covered[number])}" + asked.instead(covered)
        region = f"domain, where {name} goes from {low:.6g} to {high:.6g}" if asked.given else asked.region
        raise SamplesError(
            f"{name} reaches from {axis[0]:.6g} to {axis[-1]:.6g}, but the samples must cover the {region}: {remedy}",
            field=name,
        )
    check_beyond(name, asked, number, covered)


def check_beyond(field: str, asked: RequestedBox, number: int, covered: Box) -> None:
    """Refuse samples that go on far beyond the box: the mesh would see a corner of them only."""
    ends, (low, high), name = asked.box[number], covered[number], "xy"[number]
    rim = MAX_BEYOND * (ends[1] - ends[0])
    if low < ends[0] - rim or high > ends[1] + rim:
        remedy = f"{asked.mapped(number, low, high)}, or " if asked.is_unit else ""
        raise SamplesError(
            f"the samples reach from {low:.6g} to {high:.6g} in {name}, far beyond the"
            f" {'domain' if asked.given else asked.region} that is meshed: {remedy}send only the part in"
            f" [{ends[0]:.6g}, {ends[1]:.6g}]{asked.instead(covered)}",
            field=field,
        )


def check_size(values: Array) -> None:
    """Refuse values whose squares would overflow."""
    large = np.abs(values) > LIMITS.magnitude
    if large.any():
        index = np.unravel_index(int(np.argmax(large)), values.shape)
        place = "".join(f"[{i}]" for i in index)
        raise SamplesError(
            f"values{place} = {values[index]:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale u",
            field="values",
        )


def _check_slopes(spline: Bicubic, axes: dict[str, Array]) -> None:
    """Refuse samples so close that the slope between them is too large; coefficients of a spline bound it."""
    for name, bound in zip(axes, spline.steepest, strict=True):
        if not bound <= LIMITS.magnitude:
            i = int(np.diff(axes[name]).argmin())
            raise SamplesError(
                f"u changes too fast along {name} (its slope is over {LIMITS.magnitude:g}): {name}[{i}] and"
                f" {name}[{i + 1}] are {axes[name][i + 1] - axes[name][i]:.3g} apart; leave one out, or rescale u",
                field=name,
            )


def _bicubic(x: Array, y: Array, values: Array) -> RectBivariateSpline:
    """The interpolating bicubic spline; fewer than 4 points are first raised to 4 on their own polynomial."""
    x, values = _raised(x, values)
    y, transposed = _raised(y, values.T)
    try:
        with np.errstate(all="ignore"):
            spline = RectBivariateSpline(x, y, transposed.T, s=0)
    except ValueError as error:
        raise SamplesError(f"no spline passes through the samples: {error}", field="values") from error
    if not np.all(np.isfinite(spline.get_coeffs())):
        raise SamplesError("the samples are too large or too close for a spline: rescale them", field="values")
    return spline


def _raised(axis: Array, values: Array) -> tuple[Array, Array]:
    """At least four points along the first axis, on the same polynomial, which a cubic then reproduces."""
    if axis.size >= MIN_CUBIC:
        return axis, values
    finer = np.linspace(axis[0], axis[-1], MIN_CUBIC)
    weights = [np.prod([(finer - b) / (a - b) for b in axis if b != a], axis=0) for a in axis]
    return finer, np.stack(weights, axis=1) @ values
