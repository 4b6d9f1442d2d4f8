"""The error of a solver, estimated from its values at the nodes of a mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.least_error.kernels import Norm
from equimesh.least_error.other_errors import DualField
from equimesh.least_error.projection import MAX_CELLS
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import ValueDegree
from equimesh.numerics.types import Array
from equimesh.quality.cells import CellPoints, cells_of
from equimesh.quality.elements import CellKind
from equimesh.quality.ritz import projection
from equimesh.rounds.recovery import Recovery, on_domain
from equimesh_coupling.adaptation import MAX_UNRESOLVED_SHARE
from equimesh_coupling.goals import CONSTANT, NO_DUAL_DEGREE, NO_DUAL_TRIANGLES
from equimesh_schema import ErrorProducts

MAX_POLYNOMIAL_SHARES: Mapping[Norm, float] = {"l2": 0.02, "h1": 0.07}
"""The largest unresolved shares at which u of degree 3 and 4 is that of polynomials in the next mesh; on blocks of L2.

Above, they leave as much at the nodes as the error is, and nodes stay where they are. On a peak of 17 x 17 points the
error of degree 3 stayed as it was, and with limited cubics fell by a factor of 40; at a share of 0.002 by 3.9 and 1.8.
"""
MIN_SOLVER_SHARE = 1.1
"""The least error of a solver over that of the interpolant from which on it leads, whatever is resolved."""
MAX_UNRESOLVED_FITTED = 0.035
"""The largest share of the gradient left unresolved at which descents on fitted gradients end at a smaller error."""
PRODUCT_POINTS = 4
"""Gauss points a direction and cell for products of two errors."""


class EarlierValues(NamedTuple):
    """The values of a solver at the nodes of an earlier mesh, of degree 1."""

    mesh: Mesh
    values: Array


def are_of_poisson(earlier: EarlierValues, u: Field, unknown: float, cells: CellKind) -> bool:
    """Whether values of a solver are nearer to those for Poisson's equation, with u as solution, than to u itself.

    Both are compared at the nodes of their mesh, in L2. True where they differ by less than is ``unknown`` of u, and on
    large meshes, on which the solution is not computed.
    """
    mesh, values = earlier
    found = projection(mesh, u, triangles=cells == "triangle") if len(mesh.cells) <= MAX_CELLS else None
    if found is None:
        return True
    (nodal, added), shares = found, np.repeat(mesh.cell_areas().ravel(), mesh.cells.shape[1]) / mesh.cells.shape[1]
    weights = np.bincount(mesh.cells.ravel(), shares, len(mesh.points)) * added
    is_known = float((weights * added).sum()) > unknown**2
    return not is_known or float((weights * (2.0 * (np.ravel(values) - nodal) - added)).sum()) > 0.0


def error_products(one: Recovery, other: Recovery) -> ErrorProducts:
    """The integrals of products of the errors of ``one`` solution and of its adjoint, without their bound."""
    mesh = on_domain(one.mesh, one.domain)
    cells, points = cells_of(mesh), CellPoints.gauss(PRODUCT_POINTS)
    every = np.arange(cells.count)
    at, (s, t) = cells.at(points, every), (points.s[:, None], points.t[:, None])
    errors = []
    for known in (one, other):
        c = cells.corner_values(known.values, every)
        lower, upper = c[0] + s * (c[1] - c[0]), c[3] + s * (c[2] - c[3])
        along, across = (1.0 - t) * (c[1] - c[0]) + t * (c[2] - c[3]), upper - lower
        u, u_x, u_y = known.u.evaluate(at.x, at.y, order=1)
        slopes = (along * at.y_t - across * at.y_s) / at.det, (across * at.x_s - along * at.x_t) / at.det
        errors.append((u - lower - t * across, u_x - slopes[0], u_y - slopes[1]))
    (e, e_x, e_y), (z, z_x, z_y) = errors
    area = points.weights[:, None] * at.det
    products = (e_x * z_x + e_y * z_y, e_x * z, e_y * z, e * z)
    diffusion, stream_x, stream_y, reaction = (float((area * part).sum()) for part in products)
    return ErrorProducts(bound=0.0, diffusion=diffusion, stream_x=stream_x, stream_y=stream_y, reaction=reaction)


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorEstimate:
    """The error of a solver's values on their mesh, estimated from a u that is recovered from the values."""

    recovery: Recovery
    """u, recovered from the values."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, in the units of u times a length."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. A mesh that resolves nothing has a small one."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    is_exact: bool
    """Whether the estimate is nothing but rounding."""
    solver_share: float = 1.0
    """``estimate`` over the L2 error of the interpolant. Above 1 the mesh serves interpolation more than a solver."""
    is_of_poisson: bool = True
    """Whether earlier values of the solver, if any are given, are like those for Poisson's equation."""
    products: ErrorProducts | None = None
    """What tells the error of a functional, where its adjoint is given."""

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        values: npt.ArrayLike,
        domain: Domain | Blocks,
        threads: int = 1,
        degree: ValueDegree = 1,
        adjoint: npt.ArrayLike | None = None,
        earlier: EarlierValues | None = None,
        cells: CellKind = "quad",
    ) -> ErrorEstimate:
        """From ``values`` at the nodes of elements of a ``degree`` on ``mesh``, a mesh of ``domain``.

        With the values of an ``adjoint`` at the same nodes, on quadrilaterals, the error of the gradient is the root of
        the sum over the cells of the products of both errors, and its norm the root of the product of both. Where
        ``earlier`` values are not :func:`are_of_poisson`, the estimate is the error of the interpolant alone.

        Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
        :class:`~equimesh.errors.InputError` for a folded mesh, one of another domain, and an adjoint that is zero or of
        degree 2.
        """
        recovery = Recovery.of(mesh, values, domain, degree, cells)
        plain, size, products = recovery.estimate("l2", threads, of_solver=False), recovery.gradient_norm(), None
        is_of_poisson = earlier is None or are_of_poisson(earlier, recovery.u, plain, cells)
        estimate = recovery.of_solver(plain, threads) if is_of_poisson else plain
        is_exact = not estimate > recovery.rounding
        if adjoint is not None:
            if degree != 1:
                raise InputError(NO_DUAL_DEGREE, field="degree")
            if cells == "triangle":
                raise InputError(NO_DUAL_TRIANGLES, field="cells")
            dual = Recovery.of(mesh, adjoint, domain)
            if not dual.values.any():
                raise InputError(CONSTANT, field="adjoint")
            is_exact = is_exact or not dual.estimate("l2", threads) > dual.rounding
            size = math.sqrt(size * dual.gradient_norm())
            products = error_products(recovery, dual)
            recovery = replace(recovery, u=DualField(u=recovery.u, adjoint=dual.u))
        slopes = recovery.estimate("h1", threads)
        return cls(
            recovery=recovery,
            estimate=estimate,
            estimate_h1=slopes,
            unresolved=slopes / size if size > 0.0 else 0.0,
            is_exact=is_exact,
            solver_share=estimate / plain if plain > 0.0 else 1.0,
            is_of_poisson=is_of_poisson,
            products=products and replace(products, bound=slopes**2),
        )

    def wanted(self, norm: Norm) -> Recovery:
        """u by which the next mesh is made: limited cubics where polynomials do not see its error.

        Of degree 1 gradients are fitted where u is resolved well.
        """
        if self.recovery.degree == 1:
            is_sharp = self.unresolved <= MAX_UNRESOLVED_FITTED and self.products is None
            return self.recovery.fitted() if is_sharp else self.recovery
        share = MAX_POLYNOMIAL_SHARES[norm if self.recovery.mesh.is_grid else "l2"]
        has_polynomials = self.recovery.left is not None and self.recovery.degree > 2
        return self.recovery.limited() if has_polynomials and self.unresolved > share else self.recovery

    @property
    def is_resolved(self) -> bool:
        """Whether the mesh resolves the solution, as far as the values tell."""
        return self.unresolved <= MAX_UNRESOLVED_SHARE

    @property
    def is_for_solver(self) -> bool:
        """Whether the error of a solver leads to the next mesh. Before that the interpolant finds layers faster."""
        is_near = self.is_resolved or self.solver_share > MIN_SOLVER_SHARE
        return self.is_of_poisson and self.products is None and is_near
