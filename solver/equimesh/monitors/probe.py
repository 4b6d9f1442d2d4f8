"""Points all over a domain, at which monitors are checked and integrated before a solve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.numerics.types import Array

T = TypeVar("T", bound=Any)
AnyDomain: TypeAlias = Domain | Blocks
"""An image of the unit square, or a domain in blocks."""

# Points in a direction: enough to detect fronts as thin as a hundredth of the domain.
CELLS = 256
MAX_CELLS = CELLS**2
"""Cells of blocks in which a point lies, at most; of more cells every second is taken, or every third, and so on."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Probe:
    """Points ``x``, ``y`` of a domain, flat arrays, and ``shares``: the share of its area that each represents.

    The images of the centres of a fine uniform grid of the reference square; their number does not depend on the
    grid of the mesh. On a domain in blocks they are the centres of the cells of its initial mesh, or of some of them
    where these are many. ``diameter`` is the longer extent of the domain's box.
    """

    x: Array
    y: Array
    shares: Array
    diameter: float

    @classmethod
    def of(cls, domain: AnyDomain, cells: int = CELLS) -> Probe:
        """``cells`` by ``cells`` points of ``domain``; on a domain in blocks one a cell, of few enough of them."""
        diameter = max(high - low for low, high in domain.box)
        if isinstance(domain, Blocks):
            every = math.ceil(len(domain.mesh.cells) / MAX_CELLS)
            corners = domain.mesh.points[domain.mesh.cells[::every]]
            x, y = corners.mean(axis=1).T
            (a, b), (c, d) = (corners[:, 2] - corners[:, 0]).T, (corners[:, 3] - corners[:, 1]).T
            areas = a * d - b * c
            return cls(x=x, y=y, shares=areas / areas.sum(), diameter=diameter)
        middle = (np.arange(cells) + 0.5) / cells
        s, t = (axis.ravel() for axis in np.meshgrid(middle, middle, indexing="ij"))
        x, y = domain.map(s, t)
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        areas = x_s * y_t - x_t * y_s
        return cls(x=x, y=y, shares=areas / areas.sum(), diameter=diameter)

    @classmethod
    def of_closure(cls, domain: AnyDomain, cells: int = CELLS) -> Probe:
        """The images of the nodes, sides and corners included; ``shares`` are equal."""
        diameter = max(high - low for low, high in domain.box)
        if isinstance(domain, Blocks):
            x, y = domain.mesh.points.T
            return cls(x=x, y=y, shares=np.full(x.size, 1.0 / x.size), diameter=diameter)
        line = np.linspace(0.0, 1.0, cells + 1)
        s, t = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
        x, y = domain.map(s, t)
        return cls(x=x, y=y, shares=np.full(x.size, 1.0 / x.size), diameter=diameter)

    def place(self, index: int) -> str:
        """Point number ``index``, for a message."""
        return f"(x, y) = ({self.x[index]:.6g}, {self.y[index]:.6g})"

    def require_finite(self, values: Sequence[Array], what: str, *, field: str) -> None:
        """Raise :class:`~equimesh.errors.InputError` at the first point where one of ``values`` is not finite.

        ``what`` begins the sentence, verb included.
        """
        bad = ~np.isfinite(values[0])
        for value in values[1:]:
            bad |= ~np.isfinite(value)
        if bad.any():
            raise InputError(
                f"{what} not finite at {self.place(int(bad.argmax()))}: take a function that is smooth on the whole"
                " domain",
                field=field,
            )


def is_bound_to(bound: AnyDomain | None, domain: AnyDomain) -> bool:
    """Whether a monitor bound to ``bound`` is bound to ``domain`` already."""
    return bound is domain or (bound is not None and type(bound) is type(domain) and bool(bound == domain))


def bound_copy(monitor: T, domain: AnyDomain, /, **found: object) -> T:
    """A copy of a frozen dataclass, bound to ``domain``, with further fields ``found`` there."""
    copy = replace(monitor)
    for name, value in {"_domain": domain, **found}.items():
        object.__setattr__(copy, name, value)
    return copy
