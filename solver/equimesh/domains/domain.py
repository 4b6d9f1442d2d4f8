"""Physical domains: one-to-one images of the reference square, on which the equations are solved."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.errors import InputError
from equimesh.inputs import require_flag
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import Closed, tied_nodes
from equimesh.numerics.types import Array

# Closed lines: domains whose opposite sides are one line, so that grid lines run around.
#
# Both copies of the seam are in the arrays of a mesh: the last node of a closed line is its first one, moved by the
# period. In reference coordinates the period is 1. In the plane it is a translation, which is zero where the domain
# closes around itself, as a ring does.

Periods: TypeAlias = tuple[tuple[float, float], tuple[float, float]]
"""The translations of the plane from the first to the last node of a xi-line, and of an eta-line."""
OPEN: Closed = (False, False)
"""Four sides."""
NOWHERE: Periods = ((0.0, 0.0), (0.0, 0.0))
"""No translations."""


def closed_of(domain: object) -> Closed:
    """Whether the xi-lines and the eta-lines of a domain are closed; a domain that does not say so has four sides."""
    closed: Closed = getattr(domain, "closed_lines", OPEN)
    return closed


def is_closed(domain: object) -> bool:
    """Whether some grid lines of a domain are closed."""
    return any(closed_of(domain))


def periods_of(domain: object) -> Periods:
    """The translations of the plane from the first to the last node of a closed xi-line, and of a closed eta-line.

    They are zero for lines that are open, and where both copies of the seam are the same points.
    """
    periods: Periods = getattr(domain, "periods", NOWHERE)
    return periods


def close_seam(x: Array, y: Array, domain: object) -> None:
    """Write the second copy of each seam of a mesh of ``domain``, in place: the first one, moved by the period."""
    closed, periods = closed_of(domain), periods_of(domain)
    for axis in (0, 1):
        if closed[axis]:
            for q, period in zip((x, y), periods[axis], strict=True):
                lines = q if axis == 0 else q.T
                lines[-1] = lines[0] + period


Interval: TypeAlias = tuple[float, float]
Box: TypeAlias = tuple[Interval, Interval]

UNIT: Interval = (0.0, 1.0)
MAX_COORDINATE = 1e9  # size of a coordinate
MIN_EXTENT = 1e-9  # extent of a domain, and its share of the coordinates; below it rounding would deform the cells
FULL_TURN = 360.0
QUARTER_TURN: Interval = (0.0, 90.0)
"""The angles of a sector that gives none."""
PERIODIC = ("x", "y", "both")
"""The directions in which a rectangle may repeat itself."""


class Domain(Protocol):
    """A physical domain: the image of the points ``(s, t)`` of the unit square under a map with positive Jacobian.

    Both functions take points of any shape, broadcast against each other, and hold slightly (1e-5) beyond [0, 1], too.
    The value at a point does not depend on the other points, and ``s`` and ``t`` are not written into.
    The side ``left`` is the image of s = 0, ``right`` of s = 1, ``bottom`` of t = 0 and ``top`` of t = 1.
    :func:`equimesh.testing.check_domain` checks what is promised here.
    """

    def map(self, s: Array, t: Array) -> tuple[Array, Array]:
        """The physical points ``x, y``."""
        ...

    def jacobian(self, s: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """The exact derivatives ``x_s, x_t, y_s, y_t``; their determinant ``x_s y_t - x_t y_s`` is positive."""
        ...

    @property
    def box(self) -> Box:
        """The smallest box ``((x0, x1), (y0, y1))`` that holds the domain."""
        ...

    @property
    def area(self) -> float:
        """The area, in the square of the unit of the coordinates."""
        ...


@dataclass(frozen=True)
class Rectangle:
    """The rectangle of the points between ``x = (x0, x1)`` and ``y = (y0, y1)``; the unit square unless given.

    s runs along x and t along y. ``periodic`` names the directions in which the rectangle repeats itself: ``"x"``,
    ``"y"`` or ``"both"``. Its two sides there are one line, the seam: grid lines that cross it are closed, and the
    seam is free to bend. Implements :class:`Domain`. Raises :class:`~equimesh.errors.InputError` with the field
    ``"domain.x"`` or ``"domain.y"`` where the ends do not increase or are too large, and ``"domain.periodic"``.
    """

    x: Interval = UNIT
    y: Interval = UNIT
    _: KW_ONLY
    periodic: Literal["x", "y", "both"] | None = None

    def __post_init__(self) -> None:
        if self.periodic is not None and self.periodic not in PERIODIC:
            raise InputError(
                f"periodic = {str(self.periodic)[:20]!r}: choose 'x', 'y' or 'both', or leave it out for four sides",
                field="domain.periodic",
            )
        for name in ("x", "y"):
            ends = pair(getattr(self, name), f"domain.{name}")
            check_extent(ends, name, f"domain.{name}")
            object.__setattr__(self, name, ends)

    @property
    def closed_lines(self) -> tuple[bool, bool]:
        """Whether the lines along x and those along y are closed."""
        return self.periodic in ("x", "both"), self.periodic in ("y", "both")

    @property
    def periods(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The translations along a closed line: the width for those along x, the height for those along y."""
        along_x, along_y = self.closed_lines
        return (self.x[1] - self.x[0] if along_x else 0.0, 0.0), (0.0, self.y[1] - self.y[0] if along_y else 0.0)

    @property
    def is_unit_square(self) -> bool:
        """Whether the map is the identity."""
        return self.x == UNIT and self.y == UNIT

    def map(self, s: Array, t: Array) -> tuple[Array, Array]:
        """The physical points, as :meth:`Domain.map`; the ends are met exactly."""
        s, t = points(s, t)
        return _between(self.x, s), _between(self.y, t)

    def jacobian(self, s: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x_s, x_t, y_s, y_t``: the width and the height, and zeros."""
        shape = points(s, t)[0].shape
        return (
            np.full(shape, self.x[1] - self.x[0]),
            np.zeros(shape),
            np.zeros(shape),
            np.full(shape, self.y[1] - self.y[0]),
        )

    @property
    def box(self) -> Box:
        """The rectangle itself."""
        return self.x, self.y

    @property
    def area(self) -> float:
        """Width times height."""
        return (self.x[1] - self.x[0]) * (self.y[1] - self.y[0])


@dataclass(frozen=True, kw_only=True)
class AnnulusSector:
    """The points whose distance from ``center`` lies between ``radii``, in directions between ``angles`` (degrees).

    s runs outwards along the radius: left is the inner arc, right the outer one. t runs counter-clockwise along the
    angle. A span of 360 degrees is a full ring, cut at the first angle. ``closed`` joins the two sides of the cut: the
    lines around the ring are closed, and its seam, which begins at the first angle, is free to bend; the angles are
    then 0 to 360 unless given. Implements :class:`Domain`. Raises :class:`~equimesh.errors.InputError` with the field
    ``"domain.center"``, ``"domain.radii"``, ``"domain.angles"`` or ``"domain.closed"``.
    """

    center: tuple[float, float] = (0.0, 0.0)
    radii: Interval = (1.0, 2.0)
    angles: Interval = QUARTER_TURN
    closed: bool = False

    def __post_init__(self) -> None:
        require_flag(self.closed, "closed", "domain.")
        if self.closed and self.angles is QUARTER_TURN:
            object.__setattr__(self, "angles", (0.0, FULL_TURN))
        for name in ("center", "radii", "angles"):
            object.__setattr__(self, name, pair(getattr(self, name), f"domain.{name}"))
        (inner, outer), (first, last) = self.radii, self.angles
        if not 0.0 < inner < outer:
            raise InputError(
                f"radii = ({inner:g}, {outer:g}): the inner radius must be positive and less than the outer one",
                field="domain.radii",
            )
        check_extent(self.radii, "radii", "domain.radii", among=(*self.radii, *self.center))
        if not (first < last and last - first <= FULL_TURN and max(abs(first), abs(last)) <= 2 * FULL_TURN):
            raise InputError(
                f"angles = ({first:g}, {last:g}): the angles are in degrees, between -720 and 720, must increase, and"
                " span at most 360; across the direction of the x axis write for instance (-30, 30)",
                field="domain.angles",
            )
        if last - first < 1e-3:
            raise InputError(
                f"angles = ({first:g}, {last:g}): the angles are in degrees, and must be at least 0.001 apart",
                field="domain.angles",
            )
        if self.closed and last - first != FULL_TURN:
            raise InputError(
                f"closed = True, but the angles ({first:g}, {last:g}) span {last - first:.9g} degrees: the lines around"
                " a ring close after 360; give angles = (0, 360), or leave closed out",
                field="domain.closed",
            )

    @property
    def closed_lines(self) -> tuple[bool, bool]:
        """Whether the lines outwards and those around are closed: the latter, if the ring is ``closed``."""
        return False, self.closed

    def map(self, s: Array, t: Array) -> tuple[Array, Array]:
        """The physical points, as :meth:`Domain.map`."""
        s, t = points(s, t)
        return self._points(_between(self.radii, s), _between(self.angles, t))

    def jacobian(self, s: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x_s, x_t, y_s, y_t``, of polar coordinates."""
        s, t = points(s, t)
        radius, angle = _between(self.radii, s), _between(self.angles, t)
        cosine, sine = scipy.special.cosdg(angle), scipy.special.sindg(angle)
        width, turn = self.radii[1] - self.radii[0], radius * math.radians(self.angles[1] - self.angles[0])
        return width * cosine, -turn * sine, width * sine, turn * cosine

    @property
    def box(self) -> Box:
        """The smallest box: the corners of the sector, and the outer arc where it crosses a direction of the axes."""
        first, last = self.angles
        quarters = 90.0 * np.arange(math.ceil(first / 90.0), math.floor(last / 90.0) + 1)
        angles = np.concatenate([self.angles, self.angles, quarters])
        radii = np.concatenate([np.repeat(self.radii, 2), np.full(quarters.size, self.radii[1])])
        x, y = self._points(radii, angles)
        return (float(x.min()), float(x.max())), (float(y.min()), float(y.max()))

    def _points(self, radius: Array, angle: Array) -> tuple[Array, Array]:
        """The physical points of polar coordinates, with angles in degrees."""
        cosine, sine = scipy.special.cosdg(angle), scipy.special.sindg(angle)
        return self.center[0] + radius * cosine, self.center[1] + radius * sine

    @property
    def area(self) -> float:
        """``(r1^2 - r0^2) / 2`` times the angle."""
        inner, outer = self.radii
        return 0.5 * (outer - inner) * (outer + inner) * math.radians(self.angles[1] - self.angles[0])


def map_mesh(mesh: Mesh, domain: Domain) -> Mesh:
    """The physical mesh whose nodes are the images of those of ``mesh``, a mesh of the reference square.

    The second copy of a seam is the first one, moved by the period exactly; its nodes are tied to those of the first.
    """
    if isinstance(domain, Rectangle) and domain.is_unit_square:
        return tied(mesh, domain)
    x, y = domain.map(mesh.x, mesh.y)
    if is_closed(domain):
        close_seam(x, y, domain)
    return tied(Mesh(x, y), domain)


def tied(mesh: Mesh, domain: object) -> Mesh:
    """The grid with the ties of the closed lines of ``domain``; itself where there are none, or it has them."""
    if not is_closed(domain) or len(mesh.ties):
        return mesh
    return Mesh(mesh.x, mesh.y, ties=tied_nodes((mesh.x.shape[0], mesh.x.shape[1]), closed_of(domain)))


def points(s: npt.ArrayLike, t: npt.ArrayLike) -> tuple[Array, Array]:
    """``s`` and ``t`` as arrays of floats of one shape."""
    first, second = np.broadcast_arrays(np.asarray(s, dtype=np.float64), np.asarray(t, dtype=np.float64))
    return first, second


def pair(value: object, field: str) -> tuple[float, float]:
    """``value`` as two finite floats of at most ``MAX_COORDINATE`` in size."""
    entries = value.tolist() if isinstance(value, np.ndarray) else value
    name = field.rpartition(".")[2]
    if not isinstance(entries, (tuple, list)) or len(entries) != 2:
        raise InputError(f"{name} must be two numbers, such as (0, 1)", field=field)
    for k, entry in enumerate(entries):
        is_number = isinstance(entry, (int, float, np.integer, np.floating)) and not isinstance(entry, bool)
        if not (is_number and abs(entry) <= MAX_COORDINATE):
            raise InputError(
                f"{name}[{k}] = {str(entry)[:20]}: must be a number of at most {MAX_COORDINATE:g} in size",
                field=field,
            )
    return float(entries[0]), float(entries[1])


def check_extent(ends: Interval, name: str, field: str, *, among: tuple[float, ...] = ()) -> None:
    """Refuse ends that do not increase, or are too close for coordinates of the size ``among``."""
    low, high = ends
    if not low < high:
        raise InputError(f"{name} = ({low:g}, {high:g}): the second end must be greater than the first", field=field)
    if high - low < MIN_EXTENT * max(1.0, *map(abs, among or ends)):
        raise InputError(
            f"{name} = ({low:.12g}, {high:.12g}): the ends are too near together for these coordinates; choose the unit"
            " and the origin so that the domain has a size of about 1",
            field=field,
        )


def _between(ends: Interval, share: Array) -> Array:
    """Linear interpolation from the first of ``ends`` (at 0) to the second (at 1), exact at both."""
    return np.asarray(ends[0] * (1.0 - share) + ends[1] * share)


UNIT_SQUARE = Rectangle()


# The area that the straight sides of cells cut off the curved sides of a domain, or add to it.
#
# A cell on a curved side ends at a chord. Where nodes move apart along the side, its chord leaves out much of the
# domain, or covers much beyond it. The error of a mesh is measured on its cells alone, so that such a mesh seems
# better than it is.

PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Where a piece of a side is compared with its chord, as shares of the way from node to node in the parameter."""
WEIGHTS = (0.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 3.0, 0.0)
"""Simpson's weights of these places, over two intervals."""
MAX_MORE_SHARE = 0.25
"""A mesh may cut off this share of the area more than the initial mesh; or twice as much, where that is more."""


def areas_between(x: Array, y: Array) -> Array:
    """The areas between pieces of curves and their chords, on either side of these, shape ``(pieces,)``.

    The points of a piece at the ``PLACES`` are a row of ``x`` and ``y``, of shape ``(pieces, 5)``. The rule is exact
    for a parabola.
    """
    x, y = x - x[:, :1], y - y[:, :1]
    return np.asarray(np.abs(x * y[:, -1:] - y * x[:, -1:]) @ np.array(WEIGHTS))


def changes_of_areas(x: Array, y: Array, d_x: Array, d_y: Array) -> Array:
    """The derivatives of :func:`areas_between` where the points move by ``d_x`` and ``d_y``, shape ``(k, pieces, 5)``.

    Their shape is ``(k, pieces)``, for k ways to move.
    """
    x, y, d_x, d_y = (part - part[..., :1] for part in (x, y, d_x, d_y))
    changes = d_x * y[:, -1:] + x * d_y[..., -1:] - d_y * x[:, -1:] - y * d_x[..., -1:]
    return np.asarray((np.sign(x * y[:, -1:] - y * x[:, -1:]) * changes) @ np.array(WEIGHTS))


def cut_off(domain: Domain, begins: Array, ends: Array) -> float:
    """The area between pieces of the sides of a domain and their chords.

    ``begins`` and ``ends`` are the nodes of each piece on the reference square, of shape ``(2, pieces)``.
    """
    s, t = (np.multiply.outer(one, 1.0 - np.array(PLACES)) + np.multiply.outer(two, PLACES)
            for one, two in zip(begins, ends, strict=True))  # fmt: skip
    return float(areas_between(*domain.map(s, t)).sum())


def most_cut_off(first: float, area: float) -> float:
    """What a mesh may cut off a domain with this ``area``, whose initial mesh cuts off ``first``."""
    return first + max(first, MAX_MORE_SHARE * area)
