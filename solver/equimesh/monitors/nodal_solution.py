"""The request for the next mesh of a solver that has solved on a mesh: one round of adapting."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.fields.nodal_field import NodalField
from equimesh.fields.on_domain import recover
from equimesh.fields.quad_field import QuadField
from equimesh.meshes.grid import Grid
from equimesh.monitors.curvature import NORMS
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.monitor import Monitor, require_orthogonality
from equimesh.monitors.probe import AnyDomain, bound_copy, is_bound_to
from equimesh.numerics.types import Array

NO_OTHER_GRID = "a round keeps the points of the mesh that the values are on"
"""Why another grid is refused."""
NOT_NODAL = (
    "u must be the values of a solver at the nodes of a mesh, since the next mesh follows from that mesh: give x, y and"
    " values of one shape (n_xi, n_eta)"
)
"""Why another function is refused."""
TWO_KINDS = (
    "the values are on a mesh of a grid and the domain is in blocks, or the other way round: give values on a mesh of"
    " the domain, NodalField for a grid and QuadField for blocks"
)
"""Why values on a mesh of another kind are refused."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NodalSolution:
    """The next mesh for a solution that is known by its values ``u`` at the nodes of a mesh, and by nothing else.

    The mesh is that of :func:`equimesh.adapt_round`, which takes the same values. ``norm`` is that of the interpolation
    error of the recovered solution: ``"l2"`` of u, ``"h1"`` of its gradient. The grid of the problem is that of the
    values. On a domain in blocks u is a :class:`~equimesh.fields.quad_field.QuadField` on a mesh of the domain.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves the measures of quality: that of
    :class:`~equimesh.monitors.least_error.LeastError`. Once it is bound to a domain, ``u`` is the recovered solution.
    Raises :class:`~equimesh.errors.InputError` for another function or norm.
    """

    u: Field
    norm: Literal["l2", "h1"] = "l2"
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound, as on blocks."""
    _nodal: NodalField | QuadField | None = field(default=None, init=False, repr=False, compare=False)
    _least_error: LeastError | None = field(default=None, init=False, repr=False, compare=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_orthogonality(self.orthogonality)
        if not isinstance(self.u, NodalField | QuadField) and self._nodal is None:
            raise InputError(NOT_NODAL, field="u")
        if self.norm not in NORMS:
            raise InputError(f"norm = {self.norm!r}: choose {NORMS[0]!r} or {NORMS[1]!r}", field="norm")

    def __eq__(self, other: object) -> bool:
        """Whether another monitor is the same request: equal values at equal nodes, in the same norm."""
        if not isinstance(other, NodalSolution):
            return NotImplemented
        pairs = zip(self._arrays, other._arrays, strict=True)
        same = (self.norm, self.orthogonality) == (other.norm, other.orthogonality)
        return same and all(np.array_equal(one, another) for one, another in pairs)

    def __hash__(self) -> int:
        return hash((self.norm, self.nodal.values.shape))

    @property
    def _arrays(self) -> tuple[Array, Array, Array]:
        return self.nodal.mesh.x, self.nodal.mesh.y, self.nodal.values

    @property
    def nodal(self) -> NodalField | QuadField:
        """The values, and the mesh of their nodes."""
        if self._nodal is not None:
            return self._nodal
        if not isinstance(self.u, NodalField | QuadField):
            raise InputError(NOT_NODAL, field="u")
        return self.u

    def require_grid(self, grid: Grid) -> None:
        """Raises :class:`~equimesh.errors.InputError` for another grid than that of the values."""
        nodal = self.nodal
        if isinstance(nodal, QuadField):
            raise InputError(TWO_KINDS, field="u")
        own = nodal.mesh.grid
        if grid != own:
            raise InputError(f"{NO_OTHER_GRID}: the grid has {grid} points, the values are {own}", field="grid")

    @property
    def least_error(self) -> LeastError:
        """The least-error monitor of the recovered solution, with the same bound.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._bound

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of the curvature of the recovered solution at physical points.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._bound.metric(x, y)

    def on(self, domain: AnyDomain) -> NodalSolution:
        """The monitor bound to ``domain``.

        Raises :class:`~equimesh.errors.InputError` for values whose size cannot be squared, and for values on a mesh of
        another kind than the domain.
        """
        if is_bound_to(self._domain, domain):
            return self
        nodal = self.nodal
        recovered: Field
        if isinstance(nodal, QuadField) and isinstance(domain, Blocks):
            recovered = nodal if nodal.limited else QuadField(mesh=nodal.mesh, values=nodal.values)
        elif isinstance(nodal, QuadField) or isinstance(domain, Blocks):
            raise InputError(TWO_KINDS, field="u")
        else:
            recovered = recover(nodal.mesh, nodal.values, domain).u
        least = LeastError(u=recovered, norm=self.norm, orthogonality=self.orthogonality).on(domain)
        unbound = self
        if self._nodal is not None:
            unbound = NodalSolution(u=nodal, norm=self.norm, orthogonality=self.orthogonality)
        return bound_copy(unbound, domain, u=recovered, _nodal=nodal, _least_error=least)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return self._bound.weakened(strength)

    @property
    def _bound(self) -> LeastError:
        if self._least_error is None:
            raise InputError("the metric of a round depends on the domain: call monitor.on(domain) first")
        return self._least_error
