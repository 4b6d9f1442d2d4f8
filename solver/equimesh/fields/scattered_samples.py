"""Samples of u at scattered points, resampled once onto a grid."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.samples import (
    COVERAGE_TOLERANCE,
    MIN_CUBIC,
    GridSamples,
    RequestedBox,
    check_beyond,
    check_size,
    ends_of,
)
from equimesh.inputs import count_noun, real_array
from equimesh.numerics.types import Array

# Points of the grid in a direction.
MIN_RESAMPLING = 16
MAX_RESAMPLING = 1025
# Fewer samples are not continued to the sides.
MIN_EXTENDED_SAMPLES = 32
# Samples are continued over distances between these two, in units of their own distances.
MIN_EXTENSION = 0.25
MAX_EXTENSION = 4.0


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
    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index.
    """

    points: Array
    values: Array
    box: Box
    grid: GridSamples

    def __init__(self, *, points: npt.ArrayLike, values: npt.ArrayLike, box: Box | None = None) -> None:
        requested = RequestedBox.of(box)
        where = real_array(points, "points", ndim=2)
        if where.shape[1] != 2:
            raise SamplesError(f"points has shape {where.shape}: it must be (n, 2), one row x, y each", field="points")
        u = real_array(values, "values", ndim=1)
        if len(u) != len(where):
            raise SamplesError(
                f"there are {len(where)} points and {len(u)} values: each point needs one value",
                field="values",
            )
        check_size(u)
        if len(where):
            for number in range(2):
                check_beyond("points", requested, number, ends_of(*where.T))
        if len(u) < MIN_CUBIC:
            raise SamplesError(f"{count_noun(len(u))}: scattered samples need at least {MIN_CUBIC}", field="points")
        grid = _resample(*_distinct(where, u), requested)
        for name, value in {"points": where, "values": u, "box": requested.box, "grid": grid}.items():
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape; as ``Field.evaluate``."""
        return self.grid.evaluate(x, y, order)

    def __repr__(self) -> str:
        return f"ScatteredSamples({len(self.values)} points)"


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


def _resample(points: Array, values: Array, requested: RequestedBox) -> GridSamples:
    """Clough-Tocher interpolant of the samples on a uniform grid of the box."""
    if len(points) < MIN_CUBIC:
        raise SamplesError(f"{count_noun(len(points))} without repetitions: {MIN_CUBIC} are needed", field="points")
    box = requested.box
    low, high = np.array(box).T
    size = float((high - low).max())
    inside = int(np.count_nonzero(np.all((points >= low) & (points <= high), axis=1)))
    try:
        points, values = _extend(points, values, box)
        _check_hull(points, requested)
        shift, scale = float(values.mean()), float(np.ptp(values)) or 1.0
        interpolant = scipy.interpolate.CloughTocher2DInterpolator((points - low) / size, (values - shift) / scale)
    except scipy.spatial.QhullError as error:
        raise SamplesError(
            "the points lie on one line, or so near to it that they span no triangle: give samples all over"
            f" the {requested.region}",
            field="points",
        ) from error
    axes = [
        np.linspace(*ends, min(max(round(2 * n), MIN_RESAMPLING), MAX_RESAMPLING))
        for ends, n in zip(box, _shared(inside, box), strict=True)
    ]
    x, y = np.meshgrid(*((axis - start) / size for axis, start in zip(axes, low, strict=True)), indexing="ij")
    resampled = interpolant(x, y)
    missed = np.isnan(resampled)  # rounding can move points on the hull outside
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
    """The numbers of points along x and along y, when ``n`` points are equally dense in both directions."""
    (x0, x1), (y0, y1) = box
    aspect = math.sqrt((x1 - x0) / (y1 - y0))
    return math.sqrt(n) * aspect, math.sqrt(n) / aspect


def _extend(points: Array, values: Array, box: Box) -> tuple[Array, Array]:
    """The samples, continued to the sides of the box that they come near to.

    Cell centres end half a cell before the sides, and random points leave thin triangles along them. The added values
    are those of a thin-plate spline through the nearest samples. Nothing is added where a side is more than a few
    distances of the samples away.
    """
    if len(points) < MIN_EXTENDED_SAMPLES:
        return points, values
    tree = scipy.spatial.KDTree(points)
    own = np.asarray(tree.query(points, k=5)[0])[:, -1]
    rim = _rim(len(points), box)
    away, nearest = tree.query(rim)
    if np.any(away > MAX_EXTENSION * own[nearest]):
        return points, values
    added = rim[away > MIN_EXTENSION * own[nearest]]
    if not len(added):
        return points, values
    shift, scale = float(values.mean()), float(np.ptp(values)) or 1.0
    low, high = np.array(box).T
    size = float((high - low).max())
    try:
        spline = scipy.interpolate.RBFInterpolator(
            (points - low) / size, (values - shift) / scale, neighbors=MIN_EXTENDED_SAMPLES
        )
        extension = shift + scale * spline((added - low) / size)
    except np.linalg.LinAlgError:  # the samples next to some point lie on one line
        return points, values
    return np.concatenate([points, added]), np.concatenate([values, extension])


def _rim(n: int, box: Box) -> Array:
    """Points on the four sides of the box, as dense as ``n`` samples spread evenly over it."""
    x, y = (
        np.linspace(*ends, min(max(round(count), 1) + 1, MAX_RESAMPLING))
        for ends, count in zip(box, _shared(n, box), strict=True)
    )
    sides = [np.column_stack([x, np.full_like(x, end)]) for end in box[1]]
    sides += [np.column_stack([np.full_like(y, end), y]) for end in box[0]]
    return np.unique(np.concatenate(sides), axis=0)


def _check_hull(points: Array, requested: RequestedBox) -> None:
    """Refuse points whose convex hull leaves out a corner of the box."""
    outside = _left_out(points, requested.box)
    if not outside:
        return
    covered = ends_of(*points.T)
    remedy = "add samples at these corners"
    if requested.is_unit:
        remedy += ", or map the coordinates there" + (
            "" if _left_out(points, covered) else requested.rectangle_offer(covered)
        )
    (x0, x1), (y0, y1) = covered
    raise SamplesError(
        f"the samples reach from {x0:.6g} to {x1:.6g} in x and from {y0:.6g} to {y1:.6g} in y, and"
        f" {' '.join(outside)} {'lies' if len(outside) == 1 else 'lie'} outside their convex hull: the samples must"
        f" cover the {requested.region}; {remedy}",
        field="points",
    )


def _left_out(points: Array, box: Box) -> list[str]:
    """The corners of the box outside the convex hull of the points."""
    low, high = np.array(box).T
    hull = scipy.spatial.ConvexHull((points - low) / (high - low))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    distance = (hull.equations[:, :2] @ corners.T + hull.equations[:, 2:]).max(axis=0)
    places = low + corners * (high - low)
    return [f"({x:.6g}, {y:.6g})" for (x, y), d in zip(places, distance, strict=True) if d > COVERAGE_TOLERANCE]
