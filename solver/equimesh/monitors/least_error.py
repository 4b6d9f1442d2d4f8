"""Requests for meshes that are not given by a metric: least error, the best of several, the next mesh of a solver."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from equimesh.blocks.blocks import OTHER_CELLS, Blocks
from equimesh.domains.domain import Rectangle, map_mesh
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.fields.nodal_field import HermiteField, NodalField
from equimesh.fields.on_domain import OnDomain, recover, reference_on
from equimesh.fields.periodic import Periodic, repeated_field
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import keep_floats, require_flag
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.second_order import corners_of, lattice_of, nodes_of_cells
from equimesh.meshes.second_order import require_degree as require_value_degree
from equimesh.monitors.metrics import NORMS, Curvature
from equimesh.monitors.monitor import AnyDomain, Monitor, Probe, bound_copy, is_bound_to, require_orthogonality, weaken
from equimesh.numerics.types import Array
from equimesh_coupling.elements import MAX_DEGREE, element_shape
from equimesh_coupling.goals import CONSTANT, NO_DUAL_DEGREE, NO_DUAL_TRIANGLES
from equimesh_schema.document import is_number, is_whole

CELLS = ("quad", "triangle")
"""The cells on which the error is measured."""
MAX_WEIGHT = 1e3
"""The largest ``distortion`` and ``smoothness``."""
PROBED_CELLS = 64
"""Points a direction at which u is checked before a solve."""
MAX_FAR_SHARE = 1e-6
"""The distance of nodes of a domain with curved sides from their places on it, as a share of its size."""


def require_degree(degree: object, cells: Literal["quad", "triangle"]) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a degree that elements on these cells do not have."""
    if not (is_whole(degree) and 1 <= degree <= MAX_DEGREE):
        raise InputError(
            f"degree = {degree!r:.20}: give the degree of the elements, a whole number from 1 to {MAX_DEGREE}",
            field="degree",
        )
    if cells != "quad":
        require_value_degree(degree, cells)


def require_measured(monitor: LeastError | Auto) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a u, an angle, a norm, cells or a degree that cannot be."""
    require_fields(monitor, "u")
    require_orthogonality(monitor)
    for name, known in (("norm", NORMS), ("cells", CELLS)):
        if getattr(monitor, name) not in known:
            raise InputError(f"{name} = {getattr(monitor, name)!r}: choose {known[0]!r} or {known[1]!r}", field=name)
    require_degree(monitor.degree, monitor.cells)


PURPOSES = ("finite_element", "finite_volume", "interpolation")
"""What a mesh can be for."""


def require_purpose(purpose: object, known: tuple[str, ...], degree: int) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a purpose that is not ``known``, or has no solver of a degree."""
    if purpose not in known:
        words = " or ".join(map(repr, known))
        raise InputError(f"purpose = {purpose!r}: choose {words}", field="purpose")
    if degree > 1 and purpose != "interpolation":
        raise InputError(
            f"degree = {degree}: the purpose {purpose!r} compares solvers of lower degree; leave out the degree, or"
            " take the purpose 'interpolation'",
            field="degree",
        )


@dataclass(frozen=True)
class LeastError:
    """The nodes where the error of interpolating u is least, in place of equal lengths in a metric.

    ``norm`` is that of the error: ``"l2"`` of u, ``"h1"`` of its gradient. ``distortion`` and ``smoothness`` weigh how
    far cells may be deformed, and how unevenly neighbours: lower them for a smaller error, raise them for cells
    nearer to squares. ``cells`` are those of the file: on ``"triangle"`` the error is that of linear interpolation on
    the triangles into which :meth:`~equimesh.meshes.mesh_data.MeshData.triangles` cuts the mesh.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves the measures of quality: that of
    :class:`~equimesh.monitors.metrics.Curvature`, in which the mesh would be equidistributed if the error were that
    of its leading order. Once it is bound to a domain, ``u`` by values at nodes is interpolated without overshoots:
    see :func:`limited`. Raises :class:`~equimesh.errors.InputError` for values outside these ranges.
    """

    u: Field
    _: KW_ONLY
    norm: Literal["l2", "h1"] = "l2"
    distortion: float = 0.5
    smoothness: float = 1.0
    cells: Literal["quad", "triangle"] = "quad"
    rectilinear: bool = False
    """Whether lines stay straight: x depends on xi alone, y on eta alone. On a mapped domain they are lines of the
    reference square. Every face is then orthogonal on a rectangle."""
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    degree: int = 1
    """The degree of the elements that interpolate u: 1 to 4 on quadrilaterals, 1 or 2 on triangles.

    Their nodes are the Gauss-Lobatto points of each cell, which its bilinear map places.
    """
    purpose: Literal["finite_element", "interpolation"] = "interpolation"
    """Whose error of u is lowered: that of interpolation, or that of a solver with finite elements.

    The solver has bilinear elements, on triangles linear ones, for Poisson's equation with u as solution. On grids
    finer than about 80 x 80 points the last steps lower the error of interpolation. So do all steps in H1, where a
    solver has nearly that error.
    """
    obliqueness: float = 0.0
    """The weight of corners with angles beyond 35 degrees off a right one; 0 for none. With 30 and a distortion of 2
    most meshes have no angle of 60 degrees."""
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_measured(self)
        require_flag(self.rectilinear, "rectilinear")
        keep_floats(self, "obliqueness", "distortion", "smoothness")
        require_purpose(self.purpose, ("finite_element", "interpolation"), self.degree)
        if not (is_number(self.obliqueness) and 0.0 <= self.obliqueness <= MAX_WEIGHT):
            raise InputError(
                f"obliqueness = {self.obliqueness!r}: the weight is 0 for none, at most {MAX_WEIGHT:g}; 30 is usual",
                field="obliqueness",
            )
        for name in ("distortion", "smoothness"):
            value = getattr(self, name)
            if not (is_number(value) and 0.0 < value <= MAX_WEIGHT and math.isfinite(value)):
                raise InputError(
                    f"{name} = {value!r}: the weight must be positive, at most {MAX_WEIGHT:g}; 1 is usual", field=name
                )

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of the curvature of u at physical points.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._curvature.metric(x, y)

    def on(self, domain: AnyDomain) -> LeastError:
        """The monitor bound to ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or a derivative that the norm needs
        is not finite, and where u is so large or small that the squares of its errors are no numbers.
        """
        if is_bound_to(self._domain, domain):
            return self
        u, probe = limited(self.u, domain), Probe.of(domain, PROBED_CELLS)
        values = u.evaluate(probe.x, probe.y, order=1 if self.norm == "l2" else 2)
        probe.require_finite(values, "u or its derivatives are", field="u")
        probe.require_size(values[0])
        return bound_copy(self, domain, u=u)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return weaken(self, strength)

    @cached_property
    def _curvature(self) -> Curvature:
        if self._domain is None:
            raise InputError("the metric of a least-error monitor depends on the domain: call monitor.on(domain) first")
        return Curvature(u=self.u, norm=self.norm).on(self._domain)


def limited(u: Field, domain: AnyDomain) -> Field:
    """u by limited cubics, where it is a spline through values at the nodes of a mesh; other functions as they are.

    Between the nodes of a front a spline swings, and on a strongly graded mesh it jumps where its map has no inverse.
    A mesh of least error would follow both. In a domain with curved sides the cubics are those of its reference square.
    """
    if isinstance(u, Periodic):
        return replace(u, field=limited(u.field, u.domain))
    if not isinstance(u, NodalField):
        return u
    if isinstance(domain, Rectangle | Blocks):
        return HermiteField(mesh=u.mesh, values=u.values)
    reference = reference_on(u.mesh, domain)
    size = max(float(np.ptp(u.mesh.x)), float(np.ptp(u.mesh.y)))
    if reference.is_folded or not u.mesh.distance(map_mesh(reference, domain)) <= MAX_FAR_SHARE * size:
        return u  # the mesh is one of another domain, or of a thick ring
    own = OnDomain(reference=HermiteField(mesh=reference, values=u.values), domain=domain)
    return repeated_field(own, domain, "u")


# The request to choose the monitor by the measured error of u.


@dataclass(frozen=True)
class Auto:
    """The monitor that :func:`equimesh.solve` chooses: of several, that with the smallest error on a coarse grid.

    ``norm`` is that of the interpolation error of u that is compared: ``"l2"`` of u, ``"h1"`` of its gradient.
    ``cells`` are those of the least-error candidates.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves before the choice: that of
    :class:`~equimesh.monitors.least_error.LeastError`. Raises :class:`~equimesh.errors.InputError` for other words.
    """

    u: Field
    _: KW_ONLY
    norm: Literal["l2", "h1"] = "l2"
    cells: Literal["quad", "triangle"] = "quad"
    purpose: Literal["finite_element", "finite_volume", "interpolation"] = "finite_element"
    """What the mesh is for.

    ``"finite_element"`` chooses by the error of finite elements, for Poisson's equation with u as solution, and takes
    small angles where they cost little. ``"finite_volume"`` chooses by the error of a code with cell-centred unknowns.
    The angles have a bound then, 55 degrees if none is given. ``"interpolation"`` chooses by the interpolation error.
    """
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    degree: int = 1
    """The degree of the elements that interpolate u, as of :class:`LeastError`.

    For 2 and more the candidates are those of least error: metrics are made for degree 1.
    """
    _least_error: LeastError | None = field(default=None, init=False, repr=False, compare=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_measured(self)
        require_purpose(self.purpose, PURPOSES, 1 if self.purpose == "finite_element" else self.degree)

    @property
    def compares_solvers(self) -> bool:
        """Whether candidates are compared by the error of a solver."""
        return self.purpose == "finite_element"

    def least_error(
        self, distortion: float = LeastError.distortion, smoothness: float = LeastError.smoothness
    ) -> LeastError:
        """The least-error monitor of the same u, norm and cells, for interpolation."""
        return LeastError(
            u=self.u,
            norm=self.norm,
            distortion=distortion,
            smoothness=smoothness,
            cells=self.cells,
            orthogonality=self.orthogonality,
            degree=self.degree,
        )

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of the curvature of u at physical points.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self._bound.metric(x, y)

    def on(self, domain: AnyDomain) -> Auto:
        """The monitor bound to ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or its gradient is not finite.
        """
        if is_bound_to(self._domain, domain):
            return self
        least = self.least_error().on(domain)
        return bound_copy(self, domain, u=least.u, _least_error=least)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return self._bound.weakened(strength)

    @property
    def _bound(self) -> LeastError:
        if self._least_error is None:
            raise InputError("the metric of an auto monitor depends on the domain: call monitor.on(domain) first")
        return self._least_error


# The request for the next mesh of a solver that has solved on a mesh: one round of adapting.

NO_OTHER_GRID = "a round keeps the points of the mesh that the values are on"
"""Why another grid is refused."""
NOT_NODAL = (
    "u must be the values of a solver at the nodes of a mesh, since the next mesh follows from that mesh: give x, y and"
    " values of one shape (n_xi, n_eta)"
)
"""Why another function is refused."""
SIX_NODES = (
    "of degree 2 on triangles the nodes on the edges are their middles, and the one inside of each quadrilateral is the"
    " middle of the diagonal along which it is cut, as a file of triangles has it: in Python"
    ' element_points(mesh, 2, "triangle")'
)
"""Where the values of triangles of degree 2 are."""
NOT_EARLIER = "the earlier values are not those at the nodes of a mesh of the same kind: give them in the form of u"
"""Why other earlier values are refused."""
NOT_DUAL = "the adjoint belongs to another mesh than u: give its values at the same nodes, in the same form"
"""Why an adjoint of another mesh is refused."""
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
    values. On a domain in blocks u is a :class:`~equimesh.fields.quad_field.QuadField` on a mesh of the domain. With
    a higher ``degree`` the values are on the :func:`~equimesh.meshes.second_order.lattice_of` the mesh.

    A :class:`~equimesh.monitors.monitor.Monitor`, whose metric only serves the measures of quality: that of
    :class:`~equimesh.monitors.least_error.LeastError`. Once it is bound to a domain, ``u`` is the recovered solution.
    Raises :class:`~equimesh.errors.InputError` for another function, norm or degree.
    """

    u: Field
    norm: Literal["l2", "h1"] = "l2"
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound, as on blocks."""
    degree: int = 1
    """The degree of the elements at whose nodes the values are, 1 to 4, on triangles 1 or 2."""
    cells: Literal["quad", "triangle"] = "quad"
    """The cells of the elements. On triangles of degree 2 the inner value of each quadrilateral is that at the middle
    of the diagonal along which :meth:`~equimesh.meshes.mesh.Mesh.triangles` cuts it."""
    earlier: Field | None = None
    """Values of the same solver on an earlier mesh that resolves u, of degree 1: they tell whose error leads in L2."""
    adjoint: Field | None = None
    """The adjoint solution of a functional, whose error is then made small: values at the same nodes, of degree 1."""
    _nodal: NodalField | QuadField | None = field(default=None, init=False, repr=False, compare=False)
    _least_error: LeastError | None = field(default=None, init=False, repr=False, compare=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_orthogonality(self)
        if not isinstance(self.u, NodalField | QuadField) and self._nodal is None:
            raise InputError(NOT_NODAL, field="u")
        if self.norm not in NORMS:
            raise InputError(f"norm = {self.norm!r}: choose {NORMS[0]!r} or {NORMS[1]!r}", field="norm")
        require_value_degree(self.degree, self.cells)
        self._check_earlier()
        if self.adjoint is None:
            return
        if self.degree != 1:
            raise InputError(NO_DUAL_DEGREE, field="degree")
        if self.cells == "triangle":
            raise InputError(NO_DUAL_TRIANGLES, field="adjoint")
        nodes = self.nodal.mesh
        if not isinstance(self.adjoint, NodalField | QuadField) or self.adjoint.mesh.node_shape != nodes.node_shape:
            raise InputError(NOT_DUAL, field="adjoint")
        if self.adjoint.mesh.distance(nodes) > 0.0:
            raise InputError(NOT_DUAL, field="adjoint")
        if not self.adjoint.values.any():
            raise InputError(CONSTANT, field="adjoint")

    def _check_earlier(self) -> None:
        if self.earlier is None:
            return
        if not isinstance(self.earlier, NodalField | QuadField) or self.earlier.mesh.is_grid != self.nodal.mesh.is_grid:
            raise InputError(NOT_EARLIER, field="earlier")
        if self.earlier.mesh.is_folded:
            raise InputError("the mesh of the earlier values is folded: leave them out", field="earlier")
        if self.degree != 1:
            raise InputError("earlier values are compared for elements of degree 1: leave them out", field="earlier")

    def __eq__(self, other: object) -> bool:
        """Whether another monitor is the same request: equal values at equal nodes, in the same norm."""
        if not isinstance(other, NodalSolution):
            return NotImplemented
        pairs = zip(self._arrays, other._arrays, strict=True)
        names = ("norm", "orthogonality", "degree", "cells")
        same = all(getattr(self, name) == getattr(other, name) for name in names)
        same = same and len(self._arrays) == len(other._arrays)
        return same and all(np.array_equal(one, another) for one, another in pairs)

    def __hash__(self) -> int:
        return hash((self.norm, self.nodal.values.shape))

    @property
    def _arrays(self) -> tuple[Array, ...]:
        adjoint = () if self.dual is None else (self.dual,)
        before: Any = self.earlier
        earlier = () if before is None else (before.mesh.x, before.mesh.y, before.values)
        return self.nodal.mesh.x, self.nodal.mesh.y, self.nodal.values, *earlier, *adjoint

    @property
    def dual(self) -> Array | None:
        """The values of the adjoint at the nodes."""
        return self.adjoint.values if isinstance(self.adjoint, NodalField | QuadField) else None

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
        own, degree = nodal.mesh.grid, require_value_degree(self.degree)
        wanted = tuple(degree * (n - 1) + 1 for n in grid.shape)
        if degree > 1 and own.shape != wanted:
            order = "" if self.cells == "quad" else f"; {SIX_NODES}"
            raise InputError(
                f"{NO_OTHER_GRID}: on {grid} points elements of degree {degree} have {wanted[0]} x {wanted[1]} nodes,"
                f" and the values are {own}{order}",
                field="grid",
            )
        if degree == 1 and grid != own:
            raise InputError(f"{NO_OTHER_GRID}: the grid has {grid} points, the values are {own}", field="grid")

    def mesh_on(self, domain: AnyDomain) -> Mesh:
        """The mesh of the values on ``domain``; raises :class:`~equimesh.errors.InputError` for another one's."""
        nodes = self.nodal.mesh
        if nodes.is_grid == isinstance(domain, Blocks):
            raise InputError(TWO_KINDS, field="u")
        if self.degree == 1:
            if isinstance(domain, Blocks) and not np.array_equal(nodes.cells, domain.mesh.cells):
                raise InputError(OTHER_CELLS, field="u")
            return nodes
        if isinstance(domain, Blocks):
            (count,) = element_shape(domain.mesh, self.degree)
            if len(nodes.points) != count:
                raise InputError(
                    f"u has values at {len(nodes.points)} nodes, and elements of degree {self.degree} have {count} on"
                    " the mesh of the domain: give values on a mesh of this domain",
                    field="u",
                )
            return self._cut_as(domain.mesh.moved(nodes.points[: domain.points].copy()))
        return self._cut_as(corners_of(nodes, self.degree))

    def _cut_as(self, mesh: Mesh) -> Mesh:
        """The mesh itself, whose cells have to be cut through the nodes inside of them where elements are triangles."""
        if self.cells == "triangle":
            inside = nodes_of_cells(mesh)[:, 1, 1]
            ways = self.nodal.mesh.points[inside] - lattice_of(mesh, 2, "triangle").points[inside]
            far = int((np.abs(ways).max(axis=1) > MAX_FAR_SHARE * float(np.ptp(mesh.points, axis=0).max())).sum())
            if far:
                raise InputError(
                    f"u has nodes inside of cells that are not the middles of the cuts, {far} of {len(inside)}:"
                    f" {SIX_NODES}",
                    field="u",
                )
        return mesh

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
        nodal, degree = self.nodal, require_value_degree(self.degree)
        is_known = isinstance(nodal, QuadField) and nodal.limited and degree == 1
        mesh = self.mesh_on(domain)
        recovered: Field = nodal if is_known else recover(mesh, nodal.values, domain, degree, self.cells).u
        names = ("norm", "orthogonality", "cells")
        settings: Any = {name: getattr(self, name) for name in names} | {"degree": degree}
        least = LeastError(u=recovered, **settings).on(domain)
        unbound = self
        if self._nodal is not None:
            unbound = NodalSolution(u=nodal, earlier=self.earlier, adjoint=self.adjoint, **settings)
        return bound_copy(unbound, domain, u=recovered, _nodal=nodal, _least_error=least)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return self._bound.weakened(strength)

    @property
    def _bound(self) -> LeastError:
        if self._least_error is None:
            raise InputError("the metric of a round depends on the domain: call monitor.on(domain) first")
        return self._least_error
