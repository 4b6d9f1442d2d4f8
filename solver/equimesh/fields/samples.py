"""u as a smooth function through samples on a rectilinear grid."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.domains.domain import UNIT, Box, check_extent, pair
from equimesh.errors import SamplesError
from equimesh.fields.bicubic import Bicubic
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import count_noun, real_array
from equimesh.numerics.types import Array

UNIT_BOX: Box = (UNIT, UNIT)
# Points that a cubic needs.
MIN_CUBIC = 4
# Samples may end this far inside the box, in extents of the box.
COVERAGE_TOLERANCE = 1e-9
# Samples may reach this far beyond the box, in extents of the box: enough for ghost cells, too little for another
# domain.
MAX_BEYOND = 0.5


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class GridSamples:
    """u as the bicubic spline through samples on a rectilinear grid.

    ``values[i, j]``, of shape ``(nx, ny)``, is u at ``(x[i], y[j])``. ``x``, of shape ``(nx,)``, and ``y``,
    of shape ``(ny,)``, increase strictly and cover ``box = ((x0, x1), (y0, y1))``, that of the domain; unless given,
    they reach from 0 or less to 1 or more. For smooth u and spacing h the values are accurate to O(h^4), the gradient
    to O(h^3). With only 2 or 3 points in a direction the spline is linear or quadratic there.

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index.
    """

    x: Array
    y: Array
    values: Array
    box: Box
    _spline: Bicubic = field(repr=False)

    def __init__(self, *, x: npt.ArrayLike, y: npt.ArrayLike, values: npt.ArrayLike, box: Box | None = None) -> None:
        requested = RequestedBox.of(box)
        axes, table = checked_grid(x, y, values)
        for number, (name, axis) in enumerate(axes.items()):
            check_reach(axis, name, requested, number, ends_of(axes["x"], axes["y"]))
        spline = Bicubic.of(bicubic_spline(axes["x"], axes["y"], table))
        _check_slopes(spline, axes)
        for name, value in {**axes, "values": table, "box": requested.box, "_spline": spline}.items():
            object.__setattr__(self, name, value)

    @property
    def spline(self) -> Bicubic:
        """The spline."""
        return self._spline

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``.

        Outside the samples the nearest point of their rectangle is used.
        """
        return self._spline.evaluate(x, y, order)

    def __repr__(self) -> str:
        return f"GridSamples({self.x.size} x {self.y.size})"


def checked_grid(x: object, y: object, values: object) -> tuple[dict[str, Array], Array]:
    """The axes by their names and the table of samples on a grid, whatever domain they are for.

    Raises :class:`~equimesh.errors.SamplesError` as :class:`GridSamples` does; only a spline finds steeper faults.
    """
    axes = {"x": checked_axis(x, "x"), "y": checked_axis(y, "y")}
    table = real_array(values, "values", ndim=2)
    shape = (axes["x"].size, axes["y"].size)
    if table.shape != shape:
        hint = "; transpose it" if table.shape == shape[::-1] else ""
        raise SamplesError(
            f"values has shape {table.shape}, but x has {shape[0]} points and y has {shape[1]}:"
            f" values[i][j] is u at (x[i], y[j]), so the shape must be {shape}{hint}",
            field="values",
        )
    check_size(table)
    return axes, table


def checked_axis(value: object, name: str) -> Array:
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
    """The box that samples must cover: that of a domain given by the caller, or the unit square by default."""

    box: Box
    is_given: bool

    @classmethod
    def of(cls, box: Box | None) -> RequestedBox:
        return cls(UNIT_BOX, is_given=False) if box is None else cls(_require_box(box), is_given=True)

    @property
    def region(self) -> str:
        """The box in words."""
        (x0, x1), (y0, y1) = self.box
        return f"box [{x0:.6g}, {x1:.6g}] x [{y0:.6g}, {y1:.6g}] of the domain" if self.is_given else "unit square"

    @property
    def is_unit(self) -> bool:
        """Whether the box is that of the default domain, so that another one may be meant."""
        return self.box == UNIT_BOX

    def mapping_advice(self, number: int, low: float, high: float) -> str:
        """Advice to map an axis of the samples, the first or second, to the unit square."""
        return f"map the coordinates there, ({'xy'[number]} - {low:.6g}) / {high - low:.6g}"

    def rectangle_offer(self, covered: Box) -> str:
        """Advice to use the rectangle that the samples cover; empty where another domain was given."""
        if not self.is_unit or any(low >= high for low, high in covered):
            return ""
        x, y = (f"({low:.6g}, {high:.6g})" for low, high in covered)
        if self.is_given:
            return f", or give the domain that they cover, a rectangle with x={x}, y={y}"
        return f", or give the domain, e.g. box=({x}, {y}) here and domain=Rectangle(x={x}, y={y}) in the problem"


def ends_of(x: Array, y: Array) -> Box:
    """The smallest box around samples."""
    return (float(x.min()), float(x.max())), (float(y.min()), float(y.max()))


def check_reach(axis: Array, name: str, requested: RequestedBox, number: int, covered: Box) -> None:
    """Refuse an axis that leaves a part of the box without samples."""
    low, high = requested.box[number]
    slack = COVERAGE_TOLERANCE * (high - low)
    if axis[0] > low + slack or axis[-1] < high - slack:
        remedy = f"add samples up to {low:.6g} and {high:.6g}"
        if requested.is_unit:
            remedy += f", or {requested.mapping_advice(number, *covered[number])}" + requested.rectangle_offer(covered)
        region = f"domain, where {name} goes from {low:.6g} to {high:.6g}" if requested.is_given else requested.region
        raise SamplesError(
            f"{name} reaches from {axis[0]:.6g} to {axis[-1]:.6g}, but the samples must cover the {region}: {remedy}",
            field=name,
        )
    check_beyond(name, requested, number, covered)


def check_beyond(field: str, requested: RequestedBox, number: int, covered: Box) -> None:
    """Refuse samples that reach far beyond the box: the mesh would use only a part of them."""
    ends, (low, high), name = requested.box[number], covered[number], "xy"[number]
    rim = MAX_BEYOND * (ends[1] - ends[0])
    if low < ends[0] - rim or high > ends[1] + rim:
        remedy = f"{requested.mapping_advice(number, low, high)}, or " if requested.is_unit else ""
        raise SamplesError(
            f"the samples reach from {low:.6g} to {high:.6g} in {name}, far beyond the"
            f" {'domain' if requested.is_given else requested.region} that is meshed: {remedy}send only the part in"
            f" [{ends[0]:.6g}, {ends[1]:.6g}]{requested.rectangle_offer(covered)}",
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
    """Refuse samples with too large a slope between them, which coefficients of the spline bound."""
    for name, bound in zip(axes, spline.steepest, strict=True):
        if not bound <= LIMITS.magnitude:
            raise slope_error(axes[name], name)


def slope_error(axis: Array, name: str) -> SamplesError:
    """The error for samples with too large a slope between them."""
    i = int(np.diff(axis).argmin())
    return SamplesError(
        f"u changes too fast along {name} (its slope is over {LIMITS.magnitude:g}): {name}[{i}] and"
        f" {name}[{i + 1}] are {axis[i + 1] - axis[i]:.3g} apart; leave one out, or rescale u",
        field=name,
    )


def bicubic_spline(x: Array, y: Array, values: Array) -> scipy.interpolate.RectBivariateSpline:
    """The interpolating bicubic spline; 2 or 3 points are first increased to 4 on their polynomial."""
    x, values = _at_least_four(x, values)
    y, transposed = _at_least_four(y, values.T)
    try:
        with np.errstate(all="ignore"):
            spline = scipy.interpolate.RectBivariateSpline(x, y, transposed.T, s=0)
    except ValueError as error:
        raise SamplesError(f"no spline passes through the samples: {error}", field="values") from error
    if not np.all(np.isfinite(spline.get_coeffs())):
        raise SamplesError("the samples are too large or too close for a spline: rescale them", field="values")
    return spline


def _at_least_four(axis: Array, values: Array) -> tuple[Array, Array]:
    """At least four points along the first axis, on the same polynomial, which a cubic then reproduces."""
    if axis.size >= MIN_CUBIC:
        return axis, values
    finer = np.linspace(axis[0], axis[-1], MIN_CUBIC)
    weights = [np.prod([(finer - b) / (a - b) for b in axis if b != a], axis=0) for a in axis]
    return finer, np.stack(weights, axis=1) @ values
