"""u given by samples: values on a rectilinear grid, or at scattered points, made into a smooth function."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CloughTocher2DInterpolator, RBFInterpolator, RectBivariateSpline
from scipy.spatial import ConvexHull, KDTree, QhullError

from equimesh.domains.domain import UNIT, Box, check_extent, pair
from equimesh.errors import SamplesError
from equimesh.fields.bicubic import Bicubic
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import counted, real_array

Array: TypeAlias = npt.NDArray[np.float64]

UNIT_BOX: Box = (UNIT, UNIT)
COVERAGE_TOLERANCE = 1e-9  # and what follows: in extents of the box
FURTHEST_BEYOND = 0.5  # a rim of ghost cells is welcome, another domain is a mistake
CUBIC = 4  # points that a cubic needs
SMALLEST_RESAMPLING, LARGEST_RESAMPLING = 16, 1025
# Scattered samples are extended to the sides from this many on; between these multiples of their own distances.
FEWEST_EXTENDED = 32
NEAREST_EXTENDED, FURTHEST_EXTENDED = 0.25, 4.0


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
        asked = _Asked.of(box)
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
            _check_reach(axis, name, asked, number, _ends(axes["x"], axes["y"]))
        _check_size(table)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class ScatteredSamples:
    """u from ``values`` of shape ``(n,)`` at scattered ``points`` of shape ``(n, 2)``.

    The samples are interpolated once by the Clough-Tocher element on their Delaunay triangulation, read off
    on a uniform grid of about ``4 n`` points (16 to 1025 a side; ``n`` counts the points in the box), and become the
    :class:`GridSamples` ``grid``. For spacing h the error is about O(h^2) in the values and O(h) in the gradient:
    where u is known on a grid, give it as one.

    The points must cover ``box = ((x0, x1), (y0, y1))``, that of the domain, corners included: the unit square unless
    given. Where 32 or more come near a side but do not lie on it, as cell centres do, u is continued to the side by a
    local thin-plate spline.
    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index.
    """

    points: Array
    values: Array
    box: Box
    grid: GridSamples

    def __init__(self, *, points: npt.ArrayLike, values: npt.ArrayLike, box: Box | None = None) -> None:
        asked = _Asked.of(box)
        where = real_array(points, "points", ndim=2)
        if where.shape[1] != 2:
            raise SamplesError(f"points has shape {where.shape}: it must be (n, 2), one row x, y each", field="points")
        u = real_array(values, "values", ndim=1)
        if len(u) != len(where):
            raise SamplesError(
                f"there are {len(where)} points and {len(u)} values: each point needs one value",
                field="values",
            )
        _check_size(u)
        if len(where):
            for number in range(2):
                _check_beyond("points", asked, number, _ends(*where.T))
        if len(u) < CUBIC:
            raise SamplesError(f"{counted(len(u))}: scattered samples need at least {CUBIC}", field="points")
        grid = _resample(*_distinct(where, u), asked)
        for name, value in {"points": where, "values": u, "box": asked.box, "grid": grid}.items():
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape; as ``Field.evaluate``."""
        return self.grid.evaluate(x, y, order)

    def __repr__(self) -> str:
        return f"ScatteredSamples({len(self.values)} points)"


def _axis(value: object, name: str) -> Array:
    """A strictly increasing axis of at least two points."""
    axis = real_array(value, name, ndim=1)
    if axis.size < 2:
        raise SamplesError(
            f"{name} has {counted(axis.size, 'point')}: at least 2 are needed in each direction, {CUBIC} for"
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


def _checked_box(box: object) -> Box:
    """``box`` as two pairs of floats that increase."""
    if not isinstance(box, (tuple, list)) or len(box) != 2:
        raise SamplesError("box must be ((x0, x1), (y0, y1)), that of the domain", field="box")
    first, second = (pair(ends, "box") for ends in box)
    check_extent(first, "box: x", "box")
    check_extent(second, "box: y", "box")
    return first, second


@dataclass(frozen=True)
class _Asked:
    """The box that samples must cover, and whether the caller gave it: a domain's, or the unit square by default."""

    box: Box
    given: bool

    @classmethod
    def of(cls, box: Box | None) -> _Asked:
        return cls(UNIT_BOX, given=False) if box is None else cls(_checked_box(box), given=True)

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


def _ends(x: Array, y: Array) -> Box:
    """The smallest box around samples."""
    return (float(x.min()), float(x.max())), (float(y.min()), float(y.max()))


def _check_reach(axis: Array, name: str, asked: _Asked, number: int, covered: Box) -> None:
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
    _check_beyond(name, asked, number, covered)


def _check_beyond(field: str, asked: _Asked, number: int, covered: Box) -> None:
    """Refuse samples that go on far beyond the box: the mesh would see a corner of them only."""
    ends, (low, high), name = asked.box[number], covered[number], "xy"[number]
    rim = FURTHEST_BEYOND * (ends[1] - ends[0])
    if low < ends[0] - rim or high > ends[1] + rim:
        remedy = f"{asked.mapped(number, low, high)}, or " if asked.is_unit else ""
        raise SamplesError(
            f"the samples reach from {low:.6g} to {high:.6g} in {name}, far beyond the"
            f" {'domain' if asked.given else asked.region} that is meshed: {remedy}send only the part in"
            f" [{ends[0]:.6g}, {ends[1]:.6g}]{asked.instead(covered)}",
            field=field,
        )


def _check_size(values: Array) -> None:
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
    if axis.size >= CUBIC:
        return axis, values
    finer = np.linspace(axis[0], axis[-1], CUBIC)
    weights = [np.prod([(finer - b) / (a - b) for b in axis if b != a], axis=0) for a in axis]
    return finer, np.stack(weights, axis=1) @ values


def _distinct(points: Array, values: Array) -> tuple[Array, Array]:
    """The samples without repetitions; two values at one point are refused."""
    order = np.lexsort((np.arange(len(values)), points[:, 1], points[:, 0]))
    repeats = np.all(points[order[1:]] == points[order[:-1]], axis=1)
    differ = repeats & (values[order[1:]] != values[order[:-1]])
    if differ.any():
        k = int(np.argmax(differ))
        first, second = int(order[k]), int(order[k + 1])
        x, y = points[first]
        raise SamplesError(
            f"points[{second}] repeats points[{first}] = ({x:.6g}, {y:.6g}) with another value"
            f" ({values[second]:.6g}, not {values[first]:.6g}): keep one of them",
            field="points",
        )
    kept = np.sort(order[np.concatenate([[True], ~repeats])])
    return points[kept], values[kept]


def _resample(points: Array, values: Array, asked: _Asked) -> GridSamples:
    """Clough-Tocher interpolant of the samples on a uniform grid of the box."""
    if len(points) < CUBIC:
        raise SamplesError(f"{counted(len(points))} without repetitions: {CUBIC} are needed", field="points")
    box = asked.box
    low, high = np.array(box).T
    size = float((high - low).max())
    inside = int(np.count_nonzero(np.all((points >= low) & (points <= high), axis=1)))
    try:
        points, values = _extended(points, values, box)
        _check_hull(points, asked)
        shift, scale = float(values.mean()), float(np.ptp(values)) or 1.0
        interpolant = CloughTocher2DInterpolator((points - low) / size, (values - shift) / scale)
    except QhullError as error:
        raise SamplesError(
            "the points lie on one line, or so near to it that they span no triangle: give samples all over"
            f" the {asked.region}",
            field="points",
        ) from error
    axes = [
        np.linspace(*ends, min(max(round(2 * n), SMALLEST_RESAMPLING), LARGEST_RESAMPLING))
        for ends, n in zip(box, _shared(inside, box), strict=True)
    ]
    x, y = np.meshgrid(*((axis - start) / size for axis, start in zip(axes, low, strict=True)), indexing="ij")
    resampled = interpolant(x, y)
    missed = np.isnan(resampled)  # rounding can put points of the hull's rim outside
    inwards, (middle_x, middle_y) = 1 - 10 * COVERAGE_TOLERANCE, 0.5 * (high - low) / size
    resampled[missed] = interpolant(
        middle_x + inwards * (x[missed] - middle_x), middle_y + inwards * (y[missed] - middle_y)
    )
    if not np.all(np.isfinite(resampled)):
        i, j = np.argwhere(~np.isfinite(resampled))[0]
        raise SamplesError(
            f"the samples give no value at ({axes[0][i]:.6g}, {axes[1][j]:.6g}): add a sample there", field="points"
        )
    return GridSamples(x=axes[0], y=axes[1], values=shift + scale * resampled, box=box)


def _shared(n: int, box: Box) -> tuple[float, float]:
    """How many of ``n`` points lie along x and along y, when they are as dense in both directions."""
    (x0, x1), (y0, y1) = box
    aspect = math.sqrt((x1 - x0) / (y1 - y0))
    return math.sqrt(n) * aspect, math.sqrt(n) / aspect


def _extended(points: Array, values: Array, box: Box) -> tuple[Array, Array]:
    """The samples, and more of them on the sides of the box where they come near but do not lie there.

    Cell centres stop half a cell before the sides, and points strewn at random leave thin triangles along them. The
    values added are those of a thin-plate spline through the nearest samples; where a side is further from the samples
    than a few of their own distances, nothing is added.
    """
    if len(points) < FEWEST_EXTENDED:
        return points, values
    tree = KDTree(points)
    own = np.asarray(tree.query(points, k=5)[0])[:, -1]
    rim = _rim(len(points), box)
    away, nearest = tree.query(rim)
    if np.any(away > FURTHEST_EXTENDED * own[nearest]):
        return points, values
    added = rim[away > NEAREST_EXTENDED * own[nearest]]
    if not len(added):
        return points, values
    shift, scale = float(values.mean()), float(np.ptp(values)) or 1.0
    low, high = np.array(box).T
    size = float((high - low).max())
    try:
        spline = RBFInterpolator((points - low) / size, (values - shift) / scale, neighbors=FEWEST_EXTENDED)
        extension = shift + scale * spline((added - low) / size)
    except np.linalg.LinAlgError:  # the samples next to some point lie on one line
        return points, values
    return np.concatenate([points, added]), np.concatenate([values, extension])


def _rim(n: int, box: Box) -> Array:
    """Points on the four sides of the box, as dense as ``n`` samples spread evenly over it."""
    x, y = (
        np.linspace(*ends, min(max(round(count), 1) + 1, LARGEST_RESAMPLING))
        for ends, count in zip(box, _shared(n, box), strict=True)
    )
    sides = [np.column_stack([x, np.full_like(x, end)]) for end in box[1]]
    sides += [np.column_stack([np.full_like(y, end), y]) for end in box[0]]
    return np.unique(np.concatenate(sides), axis=0)


def _check_hull(points: Array, asked: _Asked) -> None:
    """Refuse points whose convex hull leaves out a corner of the box."""
    outside = _left_out(points, asked.box)
    if not outside:
        return
    covered = _ends(*points.T)
    remedy = "add samples at these corners"
    if asked.is_unit:
        remedy += ", or map the coordinates there" + ("" if _left_out(points, covered) else asked.instead(covered))
    (x0, x1), (y0, y1) = covered
    raise SamplesError(
        f"the samples reach from {x0:.6g} to {x1:.6g} in x and from {y0:.6g} to {y1:.6g} in y, and"
        f" {' '.join(outside)} {'lies' if len(outside) == 1 else 'lie'} outside their convex hull: the samples must"
        f" cover the {asked.region}; {remedy}",
        field="points",
    )


def _left_out(points: Array, box: Box) -> list[str]:
    """The corners of the box outside the convex hull of the points."""
    low, high = np.array(box).T
    hull = ConvexHull((points - low) / (high - low))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    distance = (hull.equations[:, :2] @ corners.T + hull.equations[:, 2:]).max(axis=0)
    places = low + corners * (high - low)
    return [f"({x:.6g}, {y:.6g})" for (x, y), d in zip(places, distance, strict=True) if d > COVERAGE_TOLERANCE]
