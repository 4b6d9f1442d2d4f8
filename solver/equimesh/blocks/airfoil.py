"""Profiles of airfoils with four digits, by their formula.

E. N. Jacobs, K. E. Ward and R. M. Pinkerton, *The characteristics of 78 related airfoil sections from tests in the
variable-density wind tunnel*, NACA Report 460 (1933). The last coefficient of the thickness is the one that closes the
trailing edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from equimesh.blocks.curves import Point, nearest_on, wrapped
from equimesh.errors import InputError
from equimesh.numerics.types import Array

# Half the thickness of a profile with thickness 1, in powers 1/2, 1, 2, 3 and 4 of the share of the chord.
THICKNESS = (1.4845, -0.63, -1.758, 1.4215, -0.518)
# Places on a profile at which the search for the nearest point begins.
SEARCH_POINTS = 1025


@dataclass(frozen=True, kw_only=True)
class Airfoil:
    """The profile with the four ``digits`` of NACA, such as ``"0012"``; a curve of boundaries.

    It begins at the trailing edge, its only corner, runs along the upper side to the leading edge and back along the
    lower side: counter-clockwise. With t from 0 to 2 the share of the chord is ``(1 - t)^2``, so that the formula is
    smooth at the leading edge, t = 1. ``leading_edge`` is its place, ``chord`` its length, ``angle`` the angle of
    attack in degrees, which turns the profile clockwise.

    Raises :class:`~equimesh.errors.InputError` with the field ``where`` for other digits.
    """

    digits: str
    chord: float = 1.0
    leading_edge: Point = (0.0, 0.0)
    angle: float = 0.0
    where: str = "domain.curves"

    def __post_init__(self) -> None:
        if not (len(self.digits) == 4 and self.digits.isascii() and self.digits.isdigit() and int(self.digits[2:]) > 0):
            message = f'naca = {self.digits[:20]!r}: four digits, the last two the thickness, such as "0012"'
            raise InputError(message, field=self.where)
        if bool(int(self.digits[0])) != bool(int(self.digits[1])):
            message = f"naca = {self.digits!r}: of camber and its place, the first two digits, both are 0 or none"
            raise InputError(message, field=self.where)

    @property
    def ends(self) -> tuple[float, float]:
        """0 and 2, both at the trailing edge."""
        return 0.0, 2.0

    @property
    def closed(self) -> bool:
        """A profile is closed."""
        return True

    @property
    def corners(self) -> Array:
        """0: the trailing edge."""
        return np.zeros(1)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, exactly differentiated."""
        root = 1.0 - wrapped(self, np.asarray(t, dtype=np.float64))  # from 1 to -1; the upper side is positive
        share, side = root**2, np.where(root < 0.0, -1.0, 1.0)
        a, b, c, d, e = (int(self.digits[2:]) / 100.0 * k for k in THICKNESS)
        half = a * root + side * share * (b + share * (c + share * (d + share * e)))
        half_t = -(a + side * 2.0 * root * (b + share * (2.0 * c + share * (3.0 * d + share * 4.0 * e))))
        rise, slope, bend = self._camber(share)
        # The thickness stands at right angles on the line of camber, whose angle is atan(slope).
        norm = np.sqrt(1.0 + slope**2)
        sine, cosine, share_t = slope / norm, 1.0 / norm, -2.0 * root
        angle_t = bend / (1.0 + slope**2) * share_t
        x, y = share - half * sine, rise + half * cosine
        x_t = share_t - half_t * sine - half * cosine * angle_t
        y_t = slope * share_t + half_t * cosine - half * sine * angle_t
        turn_x, turn_y = (
            self.chord * math.cos(math.radians(self.angle)),
            self.chord * math.sin(math.radians(self.angle)),
        )
        return (
            self.leading_edge[0] + turn_x * x + turn_y * y,
            self.leading_edge[1] - turn_y * x + turn_x * y,
            turn_x * x_t + turn_y * y_t,
            -turn_y * x_t + turn_x * y_t,
        )

    def nearest(self, x: Array, y: Array) -> Array:
        """The t of the nearest point of the profile."""
        return nearest_on(self, x, y, np.linspace(0.0, 2.0, SEARCH_POINTS))

    def _camber(self, share: Array) -> tuple[Array, Array, Array]:
        """The line of camber over the chord, and its first and second derivative."""
        height, place = int(self.digits[0]) / 100.0, int(self.digits[1]) / 10.0
        if height == 0.0:
            return np.zeros_like(share), np.zeros_like(share), np.zeros_like(share)
        ahead = share < place
        factor = height / np.where(ahead, place**2, (1.0 - place) ** 2)
        constant = np.where(ahead, 0.0, 1.0 - 2.0 * place)
        rise = factor * (constant + 2.0 * place * share - share**2)
        return rise, 2.0 * factor * (place - share), -2.0 * factor
