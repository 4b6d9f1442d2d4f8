"""The seam of a domain between four curves: two opposite sides that are one curve, on which the other two close.

Lines around an O-grid then have no end. A line that is closed needs a curve that runs smoothly through the seam, since
no node stays there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from equimesh.domains.curve import Curve, SplinePath
from equimesh.errors import InputError
from equimesh.numerics.types import Array

PAIRS = (("left", "right"), ("bottom", "top"))
"""The sides that can be a seam: of closed xi-lines, and of closed eta-lines."""
SEAM_POINTS = 129
"""Points of a seam at which both of its sides must be at one place."""
MAX_SEAM_GAP = 1e-9
"""The largest distance of the two sides there, as a share of the size of the domain."""
MAX_TURN = 60.0
"""The largest angle in degrees between the first and the last chord of points that a smooth curve goes through."""
MAX_VELOCITY_JUMP = 1e-3
"""The largest difference of the velocities at both ends of a closed curve, as a share of the larger one."""
BY_BLOCKS = (
    "begin the curve at a smooth place; or give the O-grid as blocks, whose description keeps a node at each of its"
    " 'corners', and take a BlockProblem"
)
"""The remedy for a corner at a seam."""


def seam_of(sides: Mapping[str, Curve], size: float) -> int:
    """The direction of the closed lines: 0 where left and right are one curve, 1 where bottom and top are.

    Raises :class:`~equimesh.errors.InputError` with the field ``"domain.closed"`` where no pair is one curve.
    """
    t = np.linspace(0.0, 1.0, SEAM_POINTS)
    gaps = [_gap(sides[one].evaluate(t)[:2], sides[other].evaluate(t)[:2]) for one, other in PAIRS]
    axis = int(np.argmin(gaps))
    if gaps[axis] <= MAX_SEAM_GAP * size:
        return axis
    raise InputError(
        f"closed = True, but no two opposite sides are one curve: left and right are up to {gaps[0]:.3g} apart at the"
        f" same t, bottom and top up to {gaps[1]:.3g}; give the curve at which the ring is cut twice, as left and right"
        " (then bottom and top close) or as bottom and top (then left and right close), or leave closed out",
        field="domain.closed",
    )


def closed_curve(curve: Curve, side: str) -> Curve:
    """The curve of a ``side`` that ends where it begins; a spline through points goes on smoothly there.

    Raises :class:`~equimesh.errors.InputError` with the field ``"domain.<side>"`` where it has a corner.
    """
    if isinstance(curve.path, SplinePath):
        return curve if curve.path.closed else Curve(path=_closed_spline(curve.path, side))
    x, y, *velocity = curve.evaluate(np.array([0.0, 1.0]))
    first, last = np.array(velocity).T
    if np.hypot(*(first - last)) > MAX_VELOCITY_JUMP * max(np.hypot(*first), np.hypot(*last)):
        raise InputError(
            f"{side} begins at ({x[0]:.6g}, {y[0]:.6g}) with the slope ({first[0]:.4g}, {first[1]:.4g}), but ends"
            f" there with ({last[0]:.4g}, {last[1]:.4g}): a closed line has no node that stays at this place;"
            f" {BY_BLOCKS}",
            field=f"domain.{side}",
        )
    return curve


def _closed_spline(path: SplinePath, side: str) -> SplinePath:
    places = np.array(path.points)
    first, last = places[1] - places[0], places[-1] - places[-2]
    turn = float(np.degrees(abs(np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last))))
    if turn > MAX_TURN:
        raise InputError(
            f"{side} has a corner of {180.0 - turn:.3g} degrees at ({places[0, 0]:.6g}, {places[0, 1]:.6g}), where it"
            f" begins and ends: a closed line has no node that stays there; {BY_BLOCKS}",
            field=f"domain.{side}",
        )
    return replace(path, points=(*path.points[:-1], path.points[0]), closed=True)


def _gap(one: tuple[Array, ...], other: tuple[Array, ...]) -> float:
    return float(np.hypot(one[0] - other[0], one[1] - other[1]).max())
