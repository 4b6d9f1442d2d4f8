"""Metric lengths of edges, and how they change as nodes move."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from equimesh.equations.metric import ReferenceMetric, Tensor, Vector, quadratic
from equimesh.numerics.types import Array


@dataclass(frozen=True)
class SeenGradient:
    """The gradient of u by difference stencils (Haynes and Howse, the vector w of section 4).

    All arrays have one shape, with one entry for each stencil.
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
        """The gradient of a quantity whose computational derivatives are given."""
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
class LocalMetric:
    """The metric at some points, with the gradient of u by the stencils there; all of one shape."""

    metric: ReferenceMetric
    point: Vector
    g: Vector

    @cached_property
    def base(self) -> Tensor:
        """The pointwise part ``B``."""
        return self.metric.base(*self.point)

    @cached_property
    def slopes(self) -> tuple[Tensor, Tensor] | None:
        """The derivatives of ``B`` by the two coordinates of the point; ``None`` where it is constant."""
        return self.metric.base_slopes(*self.point)

    @cached_property
    def strength(self) -> tuple[Array, Array, Vector]:
        """``k``, its derivative by ``g . B^-1 g``, and ``B^-1 g``."""
        return self.metric.strength(self.g, self.base)


@dataclass(frozen=True)
class HalfFlux:
    """Half the squared metric length ``f`` of the direction ``d``, and its derivatives."""

    d: Vector
    local: LocalMetric

    @cached_property
    def value(self) -> Array:
        """``f``."""
        k, _, _ = self.local.strength
        return 0.5 * (quadratic(self.local.base, self.d) + k * self._along_gradient**2)

    @cached_property
    def by_direction(self) -> Vector:
        """The derivative by ``d``."""
        (b11, b12, b22), g, d = self.local.base, self.local.g, self.d
        kgd = self.local.strength[0] * self._along_gradient
        return b11 * d[0] + b12 * d[1] + kgd * g[0], b12 * d[0] + b22 * d[1] + kgd * g[1]

    @cached_property
    def by_gradient(self) -> Vector:
        """The derivative by ``g``."""
        k, slope, raised = self.local.strength
        gd = self._along_gradient
        return slope * gd**2 * raised[0] + k * gd * self.d[0], slope * gd**2 * raised[1] + k * gd * self.d[1]

    @cached_property
    def by_position(self) -> Vector | None:
        """The derivative by the point where ``B`` is taken; ``None`` where that is constant."""
        if self.local.slopes is None:
            return None
        # B enters through d . B d, and through g . B^-1 g with the derivative -(B^-1 g) . dB (B^-1 g).
        _, slope, raised = self.local.strength
        weight = slope * self._along_gradient**2
        first, second = (0.5 * (quadratic(c, self.d) - weight * quadratic(c, raised)) for c in self.local.slopes)
        return first, second

    def by_node(self, weight: Array | float, share: Array | float, spread: Vector, excess: Vector) -> Vector:
        """Derivative of ``f`` by the position of one stencil node.

        ``weight`` is the node's weight in ``d``, ``share`` that in the point, ``spread`` its ``G_c``, ``excess`` its
        ``grad u(c) - g``.
        """
        through_g = self.by_gradient[0] * spread[0] + self.by_gradient[1] * spread[1]
        by_node = (
            self.by_direction[0] * weight + through_g * excess[0],
            self.by_direction[1] * weight + through_g * excess[1],
        )
        if self.by_position is None:
            return by_node
        return by_node[0] + share * self.by_position[0], by_node[1] + share * self.by_position[1]

    @property
    def _along_gradient(self) -> Array:
        g, d = self.local.g, self.d
        return np.asarray(g[0] * d[0] + g[1] * d[1])
