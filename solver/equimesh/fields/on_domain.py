"""A function of the reference square as a function of the points of a domain."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh.domains.domain import Domain, Rectangle, closed_of, map_mesh
from equimesh.fields.expression import Field
from equimesh.fields.mesh_map import MeshMap
from equimesh.fields.nodal_field import HermiteField
from equimesh.fields.patch_field import PatchField
from equimesh.fields.quad_field import QuadField
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import closed_mesh
from equimesh.meshes.second_order import ValueDegree, lattice_of
from equimesh.numerics.types import Array, Pair
from equimesh_coupling.parts import Cells

GRID = Grid(n_xi=65, n_eta=65)
"""The nodes through which splines follow the map of a domain, to start Newton's method."""
POLISHING_STEPS = 2
"""Steps of Newton's method on the map itself."""
REFERENCE_STEPS = 4
"""The same for all nodes of a mesh, from the splines of a uniform one of its own size."""
STEP = 1e-5
"""Distance of the points whose Jacobians give the second derivatives of the map; maps hold so far beyond the square."""
MAX_CACHED_DOMAINS = 4
"""Domains whose splines are kept."""


@dataclass(frozen=True, kw_only=True)
class OnDomain:
    """``reference``, a function of (s, t) in the unit square, as one of the points (x, y) of ``domain``.

    Implements :class:`~equimesh.fields.expression.Field`; second derivatives are exact up to those of the map, which
    are differences. A point outside of the domain has the value of one next to it.
    """

    reference: Field
    domain: Domain

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, by the chain rule: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        s, t = self._inverse.at(x, y)
        u, *of_u = self.reference.evaluate(s, t, order)
        if order == 0:
            return (u,)
        x_s, x_t, y_s, y_t = self.domain.jacobian(s, t)
        per_det = 1.0 / (x_s * y_t - x_t * y_s)
        s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
        u_x, u_y = of_u[0] * s_x + of_u[1] * t_x, of_u[0] * s_y + of_u[1] * t_y
        if order == 1:
            return u, u_x, u_y
        bends_x, bends_y = self._bends(s, t)
        ss, st, tt = (of_u[2 + k] - u_x * bends_x[k] - u_y * bends_y[k] for k in range(3))
        u_xx = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
        u_xy = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
        u_yy = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)
        return u, u_x, u_y, u_xx, u_xy, u_yy

    def _bends(self, s: Array, t: Array) -> tuple[list[Array], list[Array]]:
        """The second derivatives ``(ss, st, tt)`` of x and of y, from differences of the Jacobian."""
        ahead, behind = self.domain.jacobian(s + STEP, t), self.domain.jacobian(s - STEP, t)
        above, below = self.domain.jacobian(s, t + STEP), self.domain.jacobian(s, t - STEP)
        of_s = [(one - other) / (2.0 * STEP) for one, other in zip(ahead, behind, strict=True)]
        of_t = [(one - other) / (2.0 * STEP) for one, other in zip(above, below, strict=True)]
        return [of_s[0], of_s[1], of_t[1]], [of_s[2], of_s[3], of_t[3]]

    @cached_property
    def _inverse(self) -> Inverse:
        return inverse_of(self.domain)


@dataclass(frozen=True, kw_only=True, eq=False)
class Inverse:
    """The inverse of the map of a domain."""

    domain: Domain

    def at(self, x: Array, y: Array) -> Pair:
        """(s, t) of points, of their shape; those of points outside are on a side of the square."""
        if isinstance(self.domain, Rectangle):
            ((x0, x1), (y0, y1)) = self.domain.x, self.domain.y
            return np.clip((x - x0) / (x1 - x0), 0.0, 1.0), np.clip((y - y0) / (y1 - y0), 0.0, 1.0)
        places = self._splines.locate(x, y)
        s, t = (along.reshape(x.shape) / (n - 1) for along, n in zip((places.s, places.t), GRID.shape, strict=True))
        for _ in range(POLISHING_STEPS):
            at_x, at_y = self.domain.map(s, t)
            x_s, x_t, y_s, y_t = self.domain.jacobian(s, t)
            per_det = 1.0 / (x_s * y_t - x_t * y_s)
            r, q = x - at_x, y - at_y
            s = np.clip(s + (r * y_t - q * x_t) * per_det, 0.0, 1.0)
            t = np.clip(t + (q * x_s - r * y_s) * per_det, 0.0, 1.0)
        return s, t

    @cached_property
    def _splines(self) -> MeshMap:
        return MeshMap.of(map_mesh(Mesh.uniform(GRID), self.domain))


@lru_cache(maxsize=MAX_CACHED_DOMAINS)
def _kept(domain: Domain) -> Inverse:
    return Inverse(domain=domain)


def inverse_of(domain: Domain) -> Inverse:
    """The inverse of the map of a domain; kept for the next call where the domain can be hashed."""
    return _kept(domain) if isinstance(domain, Hashable) else Inverse(domain=domain)


# u as a function of x and y from the values of a solver at the nodes of a mesh of a domain.


@dataclass(frozen=True, kw_only=True, eq=False)
class RecoveredField:
    """The function ``u``, the ``reference`` mesh of the unit square, and the ``values`` at nodes of its elements."""

    u: Field
    reference: Mesh
    values: Array
    left: Array | None = None
    """What the polynomials of a :class:`~equimesh.fields.patch_field.PatchField` leave; ``None`` of another field."""


def recover(
    mesh: Mesh,
    values: npt.ArrayLike,
    domain: Any,
    degree: ValueDegree = 1,
    cells: Cells = "quad",
    *,
    fitted: bool = False,
    reference: Mesh | None = None,
) -> RecoveredField:
    """u from ``values`` at the nodes of elements of a ``degree`` on ``mesh``, one of a ``domain`` of the same kind.

    They have the shape of :func:`~equimesh.meshes.second_order.nodes_of_elements`, and on either kind of ``cells`` are
    those at the nodes of :func:`~equimesh.meshes.second_order.lattice_of` the mesh. Of degree 1 and 2 u is a
    :class:`~equimesh.fields.nodal_field.HermiteField`, on blocks a :class:`~equimesh.fields.quad_field.QuadField`. Of
    degree 1 on a grid with curved sides it is one of the reference square, so that a layer along such a side has the
    values of that side on all of it. Nodes of degree 2 lie on chords of the side, which are no lines of that square. Of
    degree 3 and more, and of degree 2 on triangles with curved sides, u is a
    :class:`~equimesh.fields.patch_field.PatchField`, whose polynomials go on up to the side.
    Of degree 1 on a grid gradients are ``fitted`` where that is requested. The ``reference`` of a grid is found, unless
    it is given. Raises as these.
    """
    nodes, is_bent = mesh if degree == 1 else lattice_of(mesh, degree, cells), not isinstance(domain, Rectangle)
    if degree > 2 or (degree == 2 and cells == "triangle" and mesh.is_grid and is_bent):
        patches = PatchField(mesh=mesh, values=values, degree=degree, cells=cells)
        reference = mesh if not mesh.is_grid else reference or reference_on(mesh, domain)
        return RecoveredField(u=patches, reference=reference, values=patches.values, left=patches.left)
    own: HermiteField | QuadField
    if not mesh.is_grid:
        own = QuadField(mesh=nodes, values=values, fitted=degree > 1)
        return RecoveredField(u=own, reference=mesh, values=own.values)
    reference = reference or reference_on(mesh, domain)
    is_mapped = degree == 1 and is_bent and not reference.is_folded  # cells of a thick ring may fold there alone
    own = HermiteField(mesh=reference if is_mapped else nodes, values=values, fitted=fitted or degree > 1)
    u = OnDomain(reference=own, domain=domain) if is_mapped else own
    return RecoveredField(u=u, reference=reference, values=own.values)


def reference_on(mesh: Mesh, domain: Domain) -> Mesh:
    """The mesh of the reference square whose image is ``mesh``; its sides are those of the square, but for seams."""
    if not isinstance(domain, Rectangle):
        return reference_of(mesh, domain)
    ((x0, x1), (y0, y1)) = domain.x, domain.y
    there = mesh if domain.is_unit_square else Mesh((mesh.x - x0) / (x1 - x0), (mesh.y - y0) / (y1 - y0))
    return closed_mesh(there, closed_of(domain))


def reference_of(mesh: Mesh, domain: Domain) -> Mesh:
    """The mesh of the reference square whose image on ``domain`` is ``mesh``: the inverse of ``map_mesh``.

    The seam of closed lines may bend: then they begin beside 0, and end as far beside 1.
    """
    closed = closed_of(domain)
    places = MeshMap.of(map_mesh(Mesh.uniform(mesh.grid), domain)).locate(mesh.x, mesh.y)
    s, t = (along.reshape(mesh.x.shape) / (n - 1) for along, n in zip((places.s, places.t), mesh.x.shape, strict=True))
    s = _unwound(s) if closed[0] else s
    t = _unwound(t.T).T if closed[1] else t
    for _ in range(REFERENCE_STEPS):
        x, y = domain.map(s, t)
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        det = x_s * y_t - x_t * y_s
        r, q = mesh.x - x, mesh.y - y
        s, t = s + (r * y_t - q * x_t) / det, t + (q * x_s - r * y_s) / det
        s, t = (along if one else np.clip(along, 0.0, 1.0) for along, one in zip((s, t), closed, strict=True))
    return closed_mesh(Mesh(s, t), closed)


def _unwound(along: Array) -> Array:
    """Places along closed lines, which are the first dimension, without jumps by a whole turn."""
    first = np.unwrap(along[0], period=1.0)
    first = first - np.round(first.mean())
    return np.asarray(np.unwrap(np.vstack([first[None], along[1:]]), axis=0, period=1.0))
