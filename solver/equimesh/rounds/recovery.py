"""The solution that is recovered from values at the nodes of a mesh, and its estimate of their error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain, is_closed, map_mesh
from equimesh.errors import InputError, SamplesError
from equimesh.fields.expression import Field
from equimesh.fields.on_domain import OnDomain, recover, reference_on
from equimesh.fields.periodic import repeated_field
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import ROUNDING_SHARE
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import (
    ValueDegree,
    lattice_of,
    nodes_of_cells,
    nodes_of_elements,
)
from equimesh.numerics.types import Array
from equimesh.quality.cells import cells_of
from equimesh.quality.elements import CellKind
from equimesh.rounds.norms import gradient_norm, gradient_norm_on_triangles, measured, nodal_norms

TWO_KINDS = (
    "the mesh is one of a grid and the domain one of blocks, or the other way round: a mesh in blocks needs its domain"
    " in blocks"
)
"""The reason why a mesh and a domain of two kinds are refused."""
RIM_SHARE = 0.05
"""How far nodes may lie from their places on the domain, as a share of the root of its area."""
MORE_ESTIMATE_POINTS = 2
"""How many Gauss points a direction and cell estimates take more than the degree of the elements."""
LEFT_SHARES: Mapping[Norm, float] = {"l2": 0.05, "h1": 0.15}
"""The shares of the norms of what polynomials leave at the nodes that count as error.

On six functions, 17 x 17 points, degree 3, estimates were 0.65 to 4 times the error on the uniform mesh: without this
part 0.16 to 1, so that uniform meshes were taken for the best.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """u as a function of x and y, recovered from the nodal values of a solver."""

    u: Field
    domain: Domain | Blocks
    mesh: Mesh
    """The mesh of the values, on the reference square; of blocks the mesh itself."""
    values: Array
    """The values at the nodes of elements: see :func:`~equimesh.meshes.second_order.nodes_of_elements`."""
    degree: ValueDegree = 1
    """The degree of these elements."""
    cells: CellKind = "quad"
    """Their cells: the quadrilaterals, or the triangles that these are cut into."""
    left: Array | None = None
    """What a recovery of degree 3 or 4 leaves at the nodes of each cell, shape ``(m, p + 1, p + 1)``."""
    rounding: float
    """The estimated L2 error that is nothing but rounding of the values."""

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        values: npt.ArrayLike,
        domain: Domain | Blocks,
        degree: ValueDegree = 1,
        cells: CellKind = "quad",
    ) -> Recovery:
        """From ``values`` at the nodes of elements of a ``degree`` on ``mesh``, a mesh of ``domain``.

        A mesh of blocks may have other numbers of cells than the domain, which is then taken with those.

        Raises as :func:`~equimesh.fields.on_domain.recover`, on blocks as
        :class:`~equimesh.fields.quad_field.QuadField`; :class:`~equimesh.errors.InputError` for a mesh with other cells
        than the domain, too, for one of another domain, and for a mesh and a domain of two kinds.
        """
        if degree > 1:
            _check_count(values, mesh, degree, cells)
        if mesh.is_grid == isinstance(domain, Blocks):
            raise InputError(TWO_KINDS, field="mesh")
        reference = None
        if isinstance(domain, Blocks):
            domain = domain.with_counts_of(mesh)
        elif not mesh.is_folded:
            reference = _reference_on(mesh, domain)
        found = recover(mesh, values, domain, degree, cells, reference=reference)
        known, u = found.values, found.u
        if isinstance(u, OnDomain) and is_closed(u.domain):  # on a rectangle a solver may leave two values at a seam
            u = repeated_field(u, u.domain, "u")
        rounding = ROUNDING_SHARE * float(np.abs(known).max()) * math.sqrt(domain.area)
        return cls(
            u=u,
            domain=domain,
            mesh=found.reference,
            values=known,
            degree=degree,
            cells=cells,
            left=found.left,
            rounding=rounding,
        )

    def limited(self) -> Recovery:
        """The same with u as limited cubics between all nodes of the elements; itself where such cells are folded."""
        domain: Any = self.domain
        nodes = lattice_of(on_domain(self.mesh, domain), self.degree)
        if nodes.is_folded:
            return self
        reference = reference_on(nodes, domain) if nodes.is_grid else None
        if reference is not None and reference.is_folded:
            return self
        return replace(self, u=recover(nodes, self.values, domain, reference=reference).u)

    def estimate(self, norm: Norm, threads: int = 1, *, of_solver: bool = True) -> float:
        """The norm of u minus its interpolant on the mesh of the values: an estimate of the solver's error.

        It is zero where the values are those of a polynomial of the degree of the elements. Layers that the mesh does
        not resolve at all are not seen. In L2 the projection stands in place of the interpolant, where :func:`measured`
        knows it, unless ``of_solver`` is false: values at the nodes of long cells can be wrong by more than the
        interpolant is. A share of what polynomials leave at the nodes counts as error.
        """
        plain = measured(self.u, self.domain, self.mesh, self._rule(norm), threads)
        if self.left is not None:
            left = nodal_norms(cells_of(on_domain(self.mesh, self.domain)), self.left)
            return math.hypot(plain, LEFT_SHARES[norm] * left[norm])
        return self.of_solver(plain, threads) if norm == "l2" and of_solver else plain

    def of_solver(self, plain: float, threads: int = 1) -> float:
        """The estimate of the error in L2 of which the part of the interpolant, ``plain``, is known."""
        if self.left is not None or not plain > self.rounding:
            return plain
        return measured(self.u, self.domain, self.mesh, self._rule("l2"), threads, of_solver=True, plain=plain)

    def _rule(self, norm: Norm) -> Rule:
        return Rule(norm=norm, cells=self.cells, points=self.degree + MORE_ESTIMATE_POINTS, degree=self.degree)

    def fitted(self) -> Recovery:
        """The recovery of degree 1 on a grid whose gradients are those of cubics; any other one is as it is."""
        if self.degree > 1 or not self.mesh.is_grid or isinstance(self.domain, Blocks):
            return self
        mesh = on_domain(self.mesh, self.domain)
        return replace(self, u=recover(mesh, self.values, self.domain, fitted=True).u)

    def gradient_norm(self) -> float:
        """The norm of the gradient of the interpolant of the values on their mesh, in the units of u."""
        mesh = on_domain(self.mesh, self.domain)
        if self.cells == "triangle":
            return gradient_norm_on_triangles(mesh, self.values.ravel(), self.degree)
        if self.degree == 1:
            return gradient_norm(cells_of(mesh), self.values)
        return nodal_norms(cells_of(mesh), self.values.ravel()[nodes_of_cells(mesh, self.degree)])["h1"]


def _check_count(values: npt.ArrayLike, mesh: Mesh, degree: ValueDegree, cells: CellKind) -> None:
    """Refuse values of another shape than the nodes of elements of a ``degree``; the message says which is needed."""
    needed, found = nodes_of_elements(mesh, degree), np.shape(values)
    inside = {"quad": "in cells", "triangle": "on the diagonals along which cells are cut"}[cells]
    if found != needed:
        raise SamplesError(
            f"values has shape {found}, and elements of degree {degree} have nodes of shape {needed} on this mesh: give"
            f" values at the nodes on edges and {inside}, too, or the degree of your elements",
            field="values",
        )


def _reference_on(mesh: Mesh, domain: Domain) -> Mesh:
    """The reference of a grid; refuses one whose nodes lie elsewhere, with the rectangle around them in the message."""
    reference = reference_on(mesh, domain)
    away = map_mesh(reference, domain).distance(mesh)
    if not away <= RIM_SHARE * math.sqrt(domain.area):
        box = ", ".join(f"{name}=({q.min():g}, {q.max():g})" for name, q in (("x", mesh.x), ("y", mesh.y)))
        raise InputError(f"the mesh is one of another domain, such as Rectangle({box}): give that one", field="mesh")
    return reference


def on_domain(reference: Mesh, domain: Domain | Blocks) -> Any:
    """The mesh of the domain whose ``reference`` is known: a mesh of its class, of blocks the mesh itself."""
    return reference if not reference.is_grid or isinstance(domain, Blocks) else map_mesh(reference, domain)
