"""The certificate of a mesh: what it was asked to be, what it is, and what to know before using it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from equimesh.interpolation import InterpolationError
from equimesh.single_domain import Mode
from equimesh.status import Status


@dataclass(frozen=True, kw_only=True)
class Relaxed:
    """One thing that was relaxed: ``what`` it is, the value ``asked`` for and the value ``reached``.

    ``"a"``, or ``"strength"`` for other monitors than arc length, is the strength of the adaptation; ``"cross_line"``
    the weight of the cross-line term that was added to the equations; ``"points"`` the points a side of the grid that
    the equations were solved on, before the mesh was interpolated to the asked one.
    """

    what: str
    asked: float
    reached: float


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What is known of a mesh, measured on the mesh itself wherever it can be.

    ``equation_residual`` is the largest relative difference of a squared metric length from the mean of its grid line,
    in the equations that were asked for: 0 on an exact solution, also where ``relaxed`` ones were solved.
    ``discretization_error`` and ``algebraic_error`` are estimates of the largest error of a node's coordinate, in units
    of the reference square, that come of the grid and of stopping the iteration; ``None`` where not known.
    ``min_jacobian`` is the smallest corner Jacobian, positive on every valid mesh and 1 on a uniform one.
    ``interpolation`` compares the mesh with the uniform one, ``None`` where there is no u.
    """

    status: Status
    mode: Mode | None
    equation_residual: float
    min_jacobian: float
    discretization_error: float | None = None
    algebraic_error: float | None = None
    relaxed: tuple[Relaxed, ...] = ()
    warnings: tuple[str, ...] = ()
    interpolation: InterpolationError | None = None

    def summary(self) -> dict[str, Any]:
        """The certificate as plain Python data, ready for JSON; a number that is not known or finite is ``None``."""
        gain = self.interpolation
        return {
            "status": str(self.status),
            "mode": None if self.mode is None else str(self.mode),
            "equation_residual": _plain(self.equation_residual),
            "discretization_error": _plain(self.discretization_error),
            "algebraic_error": _plain(self.algebraic_error),
            "min_jacobian": _plain(self.min_jacobian),
            "relaxed": [{"what": r.what, "asked": r.asked, "reached": r.reached} for r in self.relaxed],
            "warnings": list(self.warnings),
            "interpolation_gain": gain and {"l2": _plain(gain.gain_l2), "h1": _plain(gain.gain_h1)},
        }


def _plain(number: float | None) -> float | None:
    return float(number) if number is not None and math.isfinite(number) else None
