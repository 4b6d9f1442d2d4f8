"""An interface of a subdomain as rows of equations, closed by a transmission condition."""

from dataclasses import dataclass

import numpy as np

from equimesh.equations.mesh_equations import NodalState, Rows, Triplets
from equimesh.numerics.types import Array
from equimesh.schwarz.conditions import PairOfFunctionals


@dataclass(frozen=True, kw_only=True)
class InterfaceData:
    """The values of a condition's two functionals that a subdomain receives, shape ``(k,)`` each."""

    normal: Array
    tangential: Array


@dataclass(frozen=True, kw_only=True)
class Interface:
    """An interface of one window, as the condition that closes it.

    ``axis`` is the direction across the interface, ``end`` the end (0 or 1) of the window where it lies, ``line`` the
    grid line of the window on which the functionals are evaluated. ``nodes`` are those on the line that belong to this
    interface, ``free`` those of them whose tangential coordinate no physical side fixes. ``p`` is signed.
    """

    condition: PairOfFunctionals
    axis: int
    end: int
    line: int
    nodes: slice
    free: slice
    p: float
    data: InterfaceData

    def rows(self, window: NodalState) -> Rows:
        """Functional minus received value, attached to the window's outermost line."""
        turned = window if self.axis == 0 else window.turned()
        edge = -1 if self.end else 0
        normal = self.condition.normal(turned, self.line, self.p)
        tangential = self.condition.tangential(turned, self.line, self.p)
        received = np.zeros((2, turned.x.shape[1]))
        received[0, self.nodes], received[1, self.nodes] = self.data.normal, self.data.tangential
        rows, values = [], []
        triplets: Triplets = []
        for component, functional, kept in ((0, normal, self.nodes), (1, tangential, self.free)):
            row = turned.numbers[component][edge][kept]
            rows.append(row)
            values.append((functional.values - received[component])[kept])
            triplets += [(row, unknown[kept], by[kept]) for unknown, by in functional.derivatives]
        return Rows(np.concatenate(rows), np.concatenate(values), lambda: triplets)


@dataclass(frozen=True, kw_only=True)
class InterfaceCorner:
    """The node where two interfaces of a window meet: both coordinates as the diagonal neighbour has them."""

    node: tuple[int, int]
    x: float
    y: float

    def rows(self, window: NodalState) -> Rows:
        """Coordinates minus received ones."""
        unknown = np.array([numbers[self.node] for numbers in window.numbers])
        values = np.array([window.x[self.node] - self.x, window.y[self.node] - self.y])
        return Rows(unknown, values, lambda: [(unknown, unknown, np.ones(2))])
