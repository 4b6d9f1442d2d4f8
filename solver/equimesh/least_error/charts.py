"""Charts: what the unknowns of a least-error mesh are, where its nodes lie for them, and the derivatives by them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from equimesh.domains.domain import Domain, Rectangle
from equimesh.numerics.types import Array, IntArray, Pair


class Chart(Protocol):
    """The way from the unknowns of a mesh, an array of shape ``(2, nodes)``, to its physical nodes."""

    @property
    def area(self) -> float:
        """The area of the domain."""
        ...

    def on(self, nodes: IntArray) -> Chart:
        """The chart of these nodes alone, for arrays of their unknowns; all else is that of the whole domain."""
        ...

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes, contiguous."""
        ...

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements from ``start`` whose second differences are kept small, dimensionless, ``(2, nodes)``."""
        ...

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """The derivatives by the unknowns, shape ``(2, nodes)``, and their second ones, ``(3, nodes)``.

        ``collected`` are those by x and y with ``(xx, xy, yy)``, shape ``(5, nodes)``. ``bends`` are the derivatives of
        the smoothness by the ``moves``, shape ``(2, nodes)``, and ``stiffness`` its second ones, shape ``(nodes,)``.
        """
        ...


class DomainChart:
    """Coordinates of the reference square, which the map of a ``domain`` takes to the nodes."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        self._is_identity = isinstance(domain, Rectangle) and domain.is_unit_square

    @property
    def area(self) -> float:
        """The area of the domain."""
        return self.domain.area

    def on(self, nodes: IntArray) -> DomainChart:  # noqa: ARG002
        """The chart itself: it is the same for all nodes."""
        return self

    def nodes(self, mesh: Array) -> Pair:
        """x and y of the nodes."""
        if self._is_identity:
            return mesh[0], mesh[1]
        x, y = self.domain.map(mesh[0], mesh[1])
        return np.ascontiguousarray(x), np.ascontiguousarray(y)

    def moves(self, mesh: Array, start: Array) -> Array:
        """The displacements on the reference square."""
        return mesh - start

    def derivatives(self, mesh: Array, collected: Array, bends: Array, stiffness: Array) -> Pair:
        """As :meth:`Chart.derivatives`: the chain rule through the map of the domain."""
        gradient, blocks = self._pulled_back(mesh, collected)
        gradient += bends
        blocks[::2] += stiffness
        return gradient, blocks

    def _pulled_back(self, mesh: Array, collected: Array) -> Pair:
        if self._is_identity:
            return collected[:2], collected[2:]
        (g, h), (a, b, d) = collected[:2], collected[2:]
        x_s, x_t, y_s, y_t = self.domain.jacobian(mesh[0], mesh[1])
        gradient = np.stack([g * x_s + h * y_s, g * x_t + h * y_t])
        blocks = np.stack(
            [
                a * x_s * x_s + 2.0 * b * x_s * y_s + d * y_s * y_s,
                a * x_s * x_t + b * (x_s * y_t + x_t * y_s) + d * y_s * y_t,
                a * x_t * x_t + 2.0 * b * x_t * y_t + d * y_t * y_t,
            ]
        )
        return gradient, blocks
