"""The discrete metric: the gradient of u that a stencil sees, and the squared metric length of a vector.

Every equation of the method is built of one quantity, half the squared metric length of a coordinate direction,

    f = (|d|^2 + k (g . d)^2) / 2,    k = a^2 / (1 + b |g|^2),

with ``d`` the derivative of (x, y) along xi or eta and ``g`` the gradient of u seen by the mesh (the paper's w).
Moving stencil node c by ``dr`` changes ``g`` by the rank-one term ``G_c ((grad u(c) - g) . dr)``, where ``G_c`` is
the physical gradient of the node's weight in the stencil.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.monitor import ArcLength

Array: TypeAlias = npt.NDArray[np.float64]
Vector: TypeAlias = tuple[Array, Array]


@dataclass(frozen=True)
class SeenGradient:
    """The gradient of u seen by difference stencils (Haynes and Howse, the vector w of section 4).

    All arrays share one shape, that of the places where the stencils sit.
    """

    x_xi: Array
    y_xi: Array
    x_eta: Array
    y_eta: Array
    u_xi: Array
    u_eta: Array

    @property
    def jacobian(self) -> Array:
        """``x_xi y_eta - x_eta y_xi``."""
        return self.x_xi * self.y_eta - self.x_eta * self.y_xi

    def of(self, along_xi: Array | float, along_eta: Array | float) -> Vector:
        """The physical gradient of a quantity whose computational derivatives are given."""
        j = self.jacobian
        return (
            (along_xi * self.y_eta - along_eta * self.y_xi) / j,
            (along_eta * self.x_xi - along_xi * self.x_eta) / j,
        )

    @property
    def gradient(self) -> Vector:
        """The gradient of u."""
        return self.of(self.u_xi, self.u_eta)


@dataclass(frozen=True)
class HalfFlux:
    """Half the squared metric length ``f`` of a direction, and its derivatives.

    ``by_direction`` is the derivative by ``d``, ``by_gradient`` that by ``g``.
    """

    value: Array
    by_direction: Vector
    by_gradient: Vector

    @classmethod
    def along(cls, d: Vector, g: Vector, monitor: ArcLength) -> HalfFlux:
        """``f`` of direction ``d`` in the metric of gradient ``g``."""
        square = g[0] ** 2 + g[1] ** 2
        k, slope = monitor.strength(square), monitor.strength_slope(square)
        gd = g[0] * d[0] + g[1] * d[1]
        return cls(
            value=0.5 * (d[0] ** 2 + d[1] ** 2 + k * gd**2),
            by_direction=(d[0] + k * gd * g[0], d[1] + k * gd * g[1]),
            by_gradient=(slope * gd**2 * g[0] + k * gd * d[0], slope * gd**2 * g[1] + k * gd * d[1]),
        )

    def by_node(self, weight: Array | float, spread: Vector, excess: Vector) -> Vector:
        """Derivative of ``f`` by the position of one stencil node.

        ``weight`` is the node's weight in ``d``, ``spread`` its ``G_c``, ``excess`` its ``grad u(c) - g``.
        """
        through_g = self.by_gradient[0] * spread[0] + self.by_gradient[1] * spread[1]
        return (
            self.by_direction[0] * weight + through_g * excess[0],
            self.by_direction[1] * weight + through_g * excess[1],
        )
