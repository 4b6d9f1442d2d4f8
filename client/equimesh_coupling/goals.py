"""Goals: functionals of a solution whose error a mesh makes small, and the adjoint solution that tells it.

The error of a functional J of a Galerkin solution is ``J(u) - J(u_h) = a(u - u_h, z - z_h)``. There z solves the
adjoint problem ``a(v, z) = J(v)`` for all v that vanish where values of u are given (R. Becker and R. Rannacher, Acta
Numerica 10, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.adaptation import GoalRecord
from equimesh_coupling.arrays import finite, real
from equimesh_coupling.errors import BadValues, library
from equimesh_coupling.parts import Array, HasParts, IntArray, MeshParts
from equimesh_coupling.values import element_values, node_values
from equimesh_schema.certificate import ErrorProducts
from equimesh_schema.document import is_number

WeightsFunction: TypeAlias = Callable[[Any], npt.ArrayLike]
"""From a mesh to one weight for each node, in the order of the nodes."""
Region: TypeAlias = Callable[[Array, Array], npt.ArrayLike]
"""Whether points belong to a region, from arrays of x and y of one shape."""
FEW_POINTS, MANY_POINTS = 3, 32
"""Points a direction of the rule for integrals over a cell, and for a cell that lies in a region in part."""
MAX_SEARCH_STEPS = 30
"""Steps of Newton's method for the place of a point in a cell."""
EDGE = 1e-9
"""How far outside of a cell, in its own coordinates, a point on its edge may seem to be by rounding."""
NEEDS_ADJOINT = "with a goal, return WithAdjoint(u, z), or WithAdjoint(u, matrix=A, fixed=nodes), which solves for z"
NEEDS_GOAL = "an adjoint needs a goal, whose error it tells: give goal=Goal(...), or return u alone"
NO_DUAL_DEGREE = "an adjoint is known on elements of degree 1 alone: leave the degree out, or solve without a goal"
CONSTANT = "the functional is constant: no value of the solution changes it, so that its adjoint is zero everywhere"


@dataclass(frozen=True, eq=False)
class Goal:
    """A linear functional of the solution: the sum of the values at the nodes times the ``weights`` of a mesh.

    :meth:`point`, :meth:`integral`, :meth:`over_side` and :meth:`flux` make usual ones. The error of the functional is
    estimated for ``-div(diffusion grad u) + stream . grad u + reaction u = f`` where its ``diffusion`` is given, unless
    the solver returns an estimate of its own.

    Raises ``ValueError`` for numbers that no equation has.
    """

    weights: WeightsFunction
    _: KW_ONLY
    diffusion: float | None = None
    stream: tuple[float, float] = (0.0, 0.0)
    reaction: float = 0.0
    flux_side: str | None = None
    """The side of a :meth:`flux`, whose ``weights`` are 1 at its nodes."""

    def __post_init__(self) -> None:
        if not callable(self.weights):
            raise ValueError(
                "weights is no function: give one from a mesh to the weights of its nodes, or Goal.point(x, y)"
            )
        numbers = (*self.stream, self.reaction, *(() if self.diffusion is None else (self.diffusion,)))
        if not all(is_number(one) and math.isfinite(one) for one in numbers) or len(self.stream) != 2:
            raise ValueError("diffusion, stream and reaction are those of the equation: a number, a pair, and a number")

    @classmethod
    def point(cls, x: float, y: float, **equation: Any) -> Goal:
        """The value at a point."""
        return cls(lambda mesh: point_weights(mesh.mesh_parts("quad"), x, y), **equation)

    @classmethod
    def integral(cls, region: Region | None = None, **equation: Any) -> Goal:
        """The integral over a region, which tells for arrays x and y what is in it, or over the whole domain."""
        if not (region is None or callable(region)):
            raise ValueError(
                f"region = {str(region)[:40]!r}: give a function, such as lambda x, y: x > 0.5, or nothing"
            )
        return cls(lambda mesh: region_weights(mesh.mesh_parts("quad"), region), **equation)

    @classmethod
    def over_side(cls, side: str, **equation: Any) -> Goal:
        """The integral along a side, such as ``"left"``, or one of a domain in blocks."""
        return cls(lambda mesh: side_weights(mesh.mesh_parts("quad"), side), **equation)

    @classmethod
    def flux(cls, side: str, **equation: Any) -> Goal:
        """The flux ``diffusion du/dn`` out of the domain through a side where values are given: heat, drag, lift.

        It is the sum of what is left of the equations of the nodes on the side, ``A u - load``, which has the order of
        the solution, where a derivative has half of it. What the node of a corner has from the side next to it, where
        values are given there, too, is taken off. The solver returns ``matrix`` and ``load``, or z and ``value``.
        """
        return cls(lambda mesh: nodes_of_side(mesh.mesh_parts("quad"), side), flux_side=side, **equation)

    def on(self, mesh: HasParts) -> Array:
        """The weights of the nodes of ``mesh``, in their order. Raises :class:`BadValues` for another number."""
        what = "the functional"
        weights = finite(real(self.weights(mesh), what), what).ravel()
        count = len(mesh.mesh_parts().points)
        if weights.size != count:
            raise BadValues(f"{what} has {weights.size} weights, and the mesh has {count} nodes: return one for each")
        return weights

    def record(self, found: GoalValues, products: ErrorProducts) -> GoalRecord:
        """The functional of a round, from what a solver returned and the products of the estimated errors."""
        error, scale = found.error, 1.0 if self.diffusion is None else self.diffusion
        if error is None and self.diffusion is not None:
            stream = self.stream[0] * products.stream_x + self.stream[1] * products.stream_y
            error = self.diffusion * products.diffusion + stream + self.reaction * products.reaction
        return GoalRecord(value=found.value, error=error, bound=scale * products.bound)


@dataclass(frozen=True, eq=False)
class WithAdjoint:
    """What a solver returns for a goal: the solution ``u``, and the adjoint ``z`` or the ``matrix`` that gives it.

    ``u`` and ``z`` are values at the nodes, or fields of a library. ``matrix`` is the sparse one of all nodes, in their
    order, before values are given at the nodes ``fixed``, which are numbers or a mask. ``load`` is its right side,
    which a flux needs.
    """

    u: Any
    z: Any = None
    _: KW_ONLY
    matrix: Any = None
    fixed: Any = ()
    load: Any = None
    value: float | None = None
    """The functional of u, where it is not the sum by weights."""
    error: float | None = None
    """An estimate of the error of that by the solver: the residual of u, with an adjoint of higher degree."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GoalValues:
    """What a solver returned for a goal, as checked arrays at the nodes."""

    u: Array
    z: Array
    value: float
    error: float | None


def check_goal(goal: object, tolerance: object, degree: object, points: object = None) -> None:
    """Raise ``ValueError`` for a goal that cannot be used."""
    if goal is None:
        if tolerance is not None:
            raise ValueError("tolerance is that of a functional: give the goal, too")
        return
    if not isinstance(goal, Goal):
        raise ValueError(f"goal = {str(goal)[:40]!r}: give one, such as Goal.point(0.5, 0.5)")
    if degree not in (None, 1):
        raise ValueError(f"degree = {degree}: {NO_DUAL_DEGREE}")
    if points is not None:
        raise ValueError("points finds the grid for a norm of the error: give n with a goal")
    if tolerance is not None and not (is_number(tolerance) and 0.0 < tolerance < math.inf):
        raise ValueError(f"tolerance = {str(tolerance)[:20]}: give a positive number")


def goal_values(returned: Any, mesh: HasParts, goal: Goal) -> GoalValues:
    """The solution, the adjoint and the functional on ``mesh``, from what a solver ``returned``.

    Raises :class:`BadValues` for anything else, for an adjoint of another mesh, and for a functional that is constant.
    """
    if not isinstance(returned, WithAdjoint):
        raise BadValues(NEEDS_ADJOINT)
    found = element_values(returned.u, mesh)
    if found.degree != 1:
        raise BadValues(
            f"a goal needs elements of degree 1, and the solution has degree {found.degree}: solve with bilinear ones"
        )
    u, weights = found.values, goal.on(mesh)
    if not weights.any():
        raise BadValues(CONSTANT)
    matrix = None if returned.matrix is None else _matrix(returned.matrix, weights.size)
    if returned.z is not None:
        try:
            z = node_values(returned.z, mesh)
        except BadValues as error:
            raise BadValues(f"the adjoint does not belong to this mesh: {error}") from error
    elif matrix is None:
        raise BadValues(NEEDS_ADJOINT)
    else:
        z = _adjoint(matrix, weights, returned.fixed, is_flux=goal.flux_side is not None).reshape(u.shape)
    if not z.any():
        raise BadValues(CONSTANT)
    value = returned.value
    if value is None and goal.flux_side is None:
        value = float(weights @ u.ravel())
    elif value is None:
        value = _flux(returned, matrix, u.ravel(), mesh.mesh_parts("quad"), str(goal.flux_side))
    numbers = (value,) if returned.error is None else (value, returned.error)
    if not all(is_number(one) and math.isfinite(one) for one in numbers):
        raise BadValues(f"value and error of the functional are {numbers!s:.60}: return finite numbers")
    return GoalValues(u=u, z=z, value=float(value), error=None if returned.error is None else float(returned.error))


def _flux(returned: WithAdjoint, matrix: Any, u: Array, parts: MeshParts, side: str) -> float:
    """The flux through a side, by what is left of the equations of the nodes where values are given."""
    if matrix is None or returned.load is None:
        raise BadValues("a flux is what is left of the equations on its side: return matrix and load, or the value")
    load = finite(real(returned.load, "the load"), "the load").ravel()
    if load.size != u.size:
        raise BadValues(f"the load has {load.size} values, and the mesh has {u.size} nodes: return one for each")
    left = matrix @ u - load
    if np.size(returned.fixed):
        left[_free_nodes(returned.fixed, u.size)] = 0.0
    return float(flux_weights(parts, side) @ left)


def _matrix(given: Any, count: int) -> Any:
    """The matrix in rows; raises :class:`BadValues` for one of another number of nodes."""
    sparse = library("scipy.sparse", install="pip install scipy", package="scipy")
    try:
        matrix = sparse.csr_matrix(given)
    except (TypeError, ValueError) as error:
        raise BadValues(f"the matrix is no sparse one ({error!s:.80}): give one of scipy, or an array") from error
    real(matrix.data, "the matrix")
    if matrix.shape != (count, count):
        raise BadValues(
            f"the matrix has the shape {matrix.shape}, and the mesh has {count} nodes: give that of all nodes, before"
            " those with given values are taken out"
        )
    return matrix


def _adjoint(matrix: Any, weights: Array, fixed: Any, *, is_flux: bool) -> Array:
    """The solution of the adjoint problem: 0 at the ``fixed`` nodes, for a flux -1 at those of its side."""
    solver = library("scipy.sparse.linalg", install="pip install scipy", package="scipy")
    is_free = _free_nodes(fixed, weights.size)
    right = matrix.T @ weights if is_flux else weights
    z = -weights if is_flux else np.zeros(weights.size)
    if is_flux and is_free[weights != 0.0].any():
        raise BadValues("values are not given on all of the side of the flux: name its nodes in fixed")
    free = np.flatnonzero(is_free)
    if not free.size or not right[free].any():
        raise BadValues(CONSTANT)
    try:
        z[free] = solver.splu(matrix[free][:, free].T.tocsc()).solve(right[free])
    except RuntimeError as error:
        raise BadValues(
            f"the matrix of the free nodes is singular ({error}): name those with given values in fixed"
        ) from error
    return finite(z, "the adjoint")


def _free_nodes(fixed: Any, count: int) -> npt.NDArray[np.bool_]:
    """Whether each node is none of the ``fixed`` ones, which are numbers or a mask."""
    is_free = np.ones(count, dtype=bool)
    try:
        is_free[np.asarray(fixed) if np.size(fixed) else []] = False
    except (IndexError, TypeError, ValueError) as error:
        raise BadValues(f"fixed names no nodes of this mesh ({error}): give their numbers, or a mask") from error
    return is_free


# Weights of usual functionals for bilinear elements.


def point_weights(parts: MeshParts, x: float, y: float) -> Array:
    """The shape functions at a point; raises :class:`BadValues` for one outside of the mesh."""
    corners = parts.points[parts.cells]
    inside = ((corners.min(axis=1) <= (x, y)) & (corners.max(axis=1) >= (x, y))).all(axis=1)
    for cell in np.flatnonzero(inside):
        s, t = _place(corners[cell], np.array([x, y]))
        if max(abs(s - 0.5), abs(t - 0.5)) <= 0.5 + EDGE:
            weights = np.zeros(len(parts.points))
            weights[parts.cells[cell]] = shape_functions(s, t)
            return weights
    raise BadValues(f"the point ({x:g}, {y:g}) lies outside of the mesh: give one inside")


def _place(corners: Array, point: Array) -> tuple[float, float]:
    """The coordinates of a point in a cell, by Newton's method; infinite where it finds none."""
    s = t = 0.5
    for _ in range(MAX_SEARCH_STEPS):
        lower, upper = corners[0] + s * (corners[1] - corners[0]), corners[3] + s * (corners[2] - corners[3])
        along = (1.0 - t) * (corners[1] - corners[0]) + t * (corners[2] - corners[3])
        across, rest = upper - lower, point - (lower + t * (upper - lower))
        det = along[0] * across[1] - along[1] * across[0]
        if det == 0.0:
            break
        s += (rest[0] * across[1] - rest[1] * across[0]) / det
        t += (rest[1] * along[0] - rest[0] * along[1]) / det
    return (s, t) if math.isfinite(s + t) else (math.inf, math.inf)


def shape_functions(s: Any, t: Any) -> Any:
    """The four bilinear shape functions, in the order of the corners of a cell."""
    return np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])


def region_weights(parts: MeshParts, region: Region | None) -> Array:
    """The integrals of the shape functions over the cells, or over what of them lies in a region."""
    cells, weights = parts.cells, np.zeros(len(parts.points))
    if region is None:
        add_integrals(parts, cells, FEW_POINTS, None, weights)
        return weights
    _, x, y, _ = _points(parts, cells, FEW_POINTS + 1)
    inside = _is_in(
        region, np.concatenate([x, parts.points[cells][..., 0].T]), np.concatenate([y, parts.points[cells][..., 1].T])
    )
    whole = inside.all(axis=0)
    add_integrals(parts, cells[whole], FEW_POINTS, None, weights)
    add_integrals(parts, cells[~whole], MANY_POINTS, region, weights)
    if not weights.any():
        raise BadValues("no cell of the mesh has a part in the region: the functional is constant")
    return weights


def _is_in(region: Region, x: Array, y: Array) -> npt.NDArray[np.bool_]:
    found = np.asarray(region(x, y))
    if found.shape != x.shape:
        raise BadValues(f"the region has answered with the shape {found.shape} for points of shape {x.shape}")
    return found.astype(bool)


def add_integrals(parts: MeshParts, cells: IntArray, points: int, region: Region | None, weights: Array) -> None:
    """Add the integrals of the shape functions over ``cells``, by ``points`` a direction."""
    if len(cells):
        shape, x, y, area = _points(parts, cells, points)
        area = area if region is None else area * _is_in(region, x, y)
        np.add.at(weights, cells.T, shape @ area)


def _points(parts: MeshParts, cells: IntArray, points: int) -> tuple[Array, Array, Array, Array]:
    """Shape functions ``(4, points)``, and x, y and areas ``(points, cells)`` of a Gauss rule, or of many midpoints."""
    if points == MANY_POINTS:
        at, share = (np.arange(points) + 0.5) / points, np.full(points, 1.0 / points)
    else:
        at, share = np.polynomial.legendre.leggauss(points)
        at, share = 0.5 * (at + 1.0), 0.5 * share
    s, t = (q.ravel() for q in np.meshgrid(at, at, indexing="ij"))
    shape = shape_functions(s, t)
    x, y = (parts.points[cells][..., k].T for k in (0, 1))
    along_s, along_t = np.stack([t - 1, 1 - t, t, -t]), np.stack([s - 1, -s, s, 1 - s])
    det = (along_s.T @ x) * (along_t.T @ y) - (along_t.T @ x) * (along_s.T @ y)
    return shape, shape.T @ x, shape.T @ y, np.outer(share, share).reshape(-1, 1) * det


def edges_of_side(parts: MeshParts, side: str) -> IntArray:
    """The edges of a side, shape ``(k, 2)``; raises :class:`BadValues` for a name that the mesh has not."""
    if side not in parts.sides:
        names = ", ".join(map(repr, parts.sides))
        raise BadValues(f"the mesh has no side {side!r:.40}: its sides are {names}")
    return parts.sides[side]


def nodes_of_side(parts: MeshParts, side: str) -> Array:
    """1 at the nodes of a side, 0 elsewhere."""
    weights = np.zeros(len(parts.points))
    weights[edges_of_side(parts, side).ravel()] = 1.0
    return weights


def flux_weights(parts: MeshParts, side: str) -> Array:
    """The weights of what is left of the equations of the nodes for the flux through a side.

    They are 1 at its nodes. The node of a corner has a part of the flux through the side next to it, too, which is
    linear between the next two nodes there: their weights take it off.
    """
    weights = nodes_of_side(parts, side)
    others = np.concatenate([parts.sides[side][:0], *(edges for name, edges in parts.sides.items() if name != side)])
    lengths = np.hypot(*(parts.points[others[:, 1]] - parts.points[others[:, 0]]).T)
    around = 0.5 * np.bincount(others.ravel(), np.repeat(lengths, 2), minlength=weights.size)
    on_side = weights[others] > 0.0
    taken = np.zeros(weights.size)
    for edge in np.flatnonzero(on_side.sum(axis=1) == 1):
        near = int(others[edge][~on_side[edge]][0])
        following = [k for k in np.flatnonzero((others == near).any(axis=1)) if k != edge]
        if len(following) != 1 or on_side[following].any():
            continue  # a side of fewer than three edges
        (after,), length = following, lengths[edge]
        slope = min(1.0, length / lengths[after])
        taken[near] += length / 6.0 * (3.0 + 2.0 * slope) / around[near]
        far = int(others[after].sum() - near)
        taken[far] -= length / 3.0 * slope / around[far]
    return weights - taken


def side_weights(parts: MeshParts, side: str) -> Array:
    """The integrals of the shape functions along a side."""
    edges, weights = edges_of_side(parts, side), np.zeros(len(parts.points))
    lengths = np.hypot(*(parts.points[edges[:, 1]] - parts.points[edges[:, 0]]).T)
    np.add.at(weights, edges, 0.5 * lengths[:, None])
    return weights
