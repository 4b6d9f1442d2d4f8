"""Goals: functionals of a solution whose error a mesh makes small, and the adjoint solution that tells it.

The error of a functional J of a Galerkin solution is ``J(u) - J(u_h) = a(u - u_h, z - z_h)``. There z solves the
adjoint problem ``a(v, z) = J(v)`` for all v that vanish where values of u are given (R. Becker and R. Rannacher, Acta
Numerica 10, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.adaptation import GoalRecord
from equimesh_coupling.arrays import finite, real
from equimesh_coupling.biquadratic import Equation, PlacesFunction, SourceFunction, functional_of_degree_2
from equimesh_coupling.errors import BadValues, InputError, library
from equimesh_coupling.functionals import (
    Region,
    flux_weights,
    nodes_of_side,
    place_of_point,
    places_in_region,
    places_on_side,
    shape_functions,
)
from equimesh_coupling.parts import Array, BoolArray, HasParts, MeshParts
from equimesh_coupling.values import element_values, node_values
from equimesh_schema.certificate import ErrorProducts
from equimesh_schema.document import is_number

WeightsFunction: TypeAlias = Callable[[Any], npt.ArrayLike]
"""From a mesh to one weight for each node, in the order of the nodes."""
POINT_NODES = 4
"""Nodes with weights, at most, of a functional that is the value at a point."""
NEEDS_ADJOINT = "with a goal, return WithAdjoint(u, z), or WithAdjoint(u, matrix=A, fixed=nodes), which solves for z"
NEEDS_GOAL = "an adjoint needs a goal, whose error it tells: give goal=Goal(...), or return u alone"
NO_DUAL_DEGREE = "an adjoint is known on elements of degree 1 alone: leave the degree out, or solve without a goal"
NO_DUAL_TRIANGLES = "with an adjoint errors are those on quadrilaterals: leave cells='triangle' out"
NO_NORM = "with a goal the error is that of the functional, not a norm: leave norm out, or the goal"
CONSTANT = "the functional is constant: no value of the solution changes it, so that its adjoint is zero everywhere"


@dataclass(frozen=True, eq=False)
class Goal:
    """A linear functional of the solution: the sum of the values at the nodes times the ``weights`` of a mesh.

    :meth:`point`, :meth:`integral`, :meth:`over_side` and :meth:`flux` make usual ones. The error of the functional is
    estimated for ``-div(diffusion grad u) + stream . grad u + reaction u = source`` where its ``diffusion`` is given,
    unless the solver returns an estimate of its own. With the ``source``, a number or a function of x and y, it is
    estimated by a solution of degree 2 on halved cells, but for weights of your own: ``fixed`` of the solver then has
    all nodes with given values, and nothing flows through the rest of the boundary. Without it recovered u and z tell
    it, but for the value at a point, whose adjoint they do not tell.

    Raises :class:`InputError` for numbers that no equation has.
    """

    weights: WeightsFunction
    _: KW_ONLY
    diffusion: float | None = None
    stream: tuple[float, float] = (0.0, 0.0)
    reaction: float = 0.0
    source: SourceFunction | float | None = None
    places: PlacesFunction | None = None
    """The places in cells whose values make the functional, where ``weights`` follow from them."""
    flux_side: str | None = None
    """The side of a :meth:`flux`, whose ``weights`` are 1 at its nodes."""

    def __post_init__(self) -> None:
        if not callable(self.weights):
            raise InputError(
                "weights is no function: give one from a mesh to the weights of its nodes, or Goal.point(x, y)",
                field="weights",
            )
        if self.diffusion is not None and not (_is_finite(self.diffusion) and self.diffusion > 0.0):
            raise InputError(
                f"diffusion = {self.diffusion!r:.40} is none of an equation: give a positive number", field="diffusion"
            )
        if not (isinstance(self.stream, Sequence | np.ndarray) and len(self.stream) == 2 and _is_finite(*self.stream)):
            raise InputError(
                f"stream = {self.stream!r:.40} is none of an equation: give a pair of numbers", field="stream"
            )
        if not _is_finite(self.reaction):
            raise InputError(
                f"reaction = {self.reaction!r:.40} is none of an equation: give a number", field="reaction"
            )
        if self.source is not None and not (callable(self.source) or _is_finite(self.source)):
            raise InputError(
                "source is the right side of the equation: a number, or a function of x and y", field="source"
            )
        if self.source is not None and self.diffusion is None:
            raise InputError("source is that of an equation: give its diffusion, too", field="diffusion")

    @classmethod
    def point(cls, x: float, y: float, **equation: Any) -> Goal:
        """The value at a point."""
        if not _is_finite(x, y):
            raise InputError(f"the point is ({x!s:.20}, {y!s:.20}): give two finite numbers", field="point")
        return cls._of(lambda parts: place_of_point(parts, x, y), equation)

    @classmethod
    def integral(cls, region: Region | None = None, **equation: Any) -> Goal:
        """The integral over a region, which tells for arrays x and y what is in it, or over the whole domain."""
        if not (region is None or callable(region)):
            raise InputError(
                f"region = {str(region)[:40]!r}: give a function, such as lambda x, y: x > 0.5, or nothing",
                field="region",
            )
        return cls._of(lambda parts: places_in_region(parts, region), equation)

    @classmethod
    def over_side(cls, side: str, **equation: Any) -> Goal:
        """The integral along a side, such as ``"left"``, or one of a domain in blocks."""
        return cls._of(lambda parts: places_on_side(parts, side), equation)

    @classmethod
    def flux(cls, side: str, **equation: Any) -> Goal:
        """The flux ``diffusion du/dn`` out of the domain through a side where values are given: heat, drag, lift.

        It is the sum of what is left of the equations of the nodes on the side, ``A u - load``, which has the order of
        the solution, where a derivative has half of it. What the node of a corner has from the side next to it, where
        values are given there, too, is taken off. The solver returns ``matrix`` and ``load``, or z and ``value``.
        """
        return cls(lambda mesh: nodes_of_side(mesh.mesh_parts("quad"), side), flux_side=side, **equation)

    @classmethod
    def _of(cls, places: PlacesFunction, equation: dict[str, Any]) -> Goal:
        def weights(mesh: HasParts) -> Array:
            parts = mesh.mesh_parts("quad")
            return places(parts).on(parts.cells, len(parts.points), shape_functions)

        return cls(weights, places=places, **equation)

    def on(self, mesh: HasParts) -> Array:
        """The weights of the nodes of ``mesh``, in their order. Raises :class:`BadValues` for another number."""
        what = "the functional"
        weights = finite(real(self.weights(mesh), what), what, "where each node needs a number").ravel()
        count = len(mesh.mesh_parts().points)
        if weights.size != count:
            raise BadValues(f"{what} has {weights.size} weights, and the mesh has {count} nodes: return one for each")
        return weights

    def record(self, found: GoalValues, products: ErrorProducts) -> GoalRecord:
        """The functional of a round, from what a solver returned and the products of the estimated errors."""
        error, scale = found.error, 1.0 if self.diffusion is None else self.diffusion
        if error is None and self.diffusion is not None and not found.is_point:
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
    is_point: bool = False
    """Whether the functional is the value at a point, whose adjoint recovered values do not tell."""


def check_goal(
    goal: object,
    tolerance: object,
    degree: object,
    *,
    norm: object = None,
    points: object = None,
    cells: object = None,
) -> None:
    """Raise :class:`InputError` for a goal that cannot be used, and for what has no meaning with one."""
    if goal is None:
        if tolerance is not None:
            raise InputError("tolerance is that of a functional: give the goal, too", field="tolerance")
        return
    if not isinstance(goal, Goal):
        raise InputError(f"goal = {str(goal)[:40]!r}: give one, such as Goal.point(0.5, 0.5)", field="goal")
    if norm is not None:
        raise InputError(f"norm = {norm!r:.20}: {NO_NORM}", field="norm")
    if degree not in (None, 1):
        raise InputError(f"degree = {degree}: {NO_DUAL_DEGREE}", field="degree")
    if cells == "triangle":
        raise InputError(NO_DUAL_TRIANGLES, field="cells")
    if points is not None:
        raise InputError(
            "points finds the mesh for a norm of the error: give n with a goal, on blocks neither", field="points"
        )
    if tolerance is not None and not (is_number(tolerance) and 0.0 < tolerance < math.inf):
        raise InputError(f"tolerance = {repr(tolerance)[:20]}: give a positive number", field="tolerance")


def _is_finite(*numbers: object) -> bool:
    """Whether all are finite numbers."""
    return all(is_number(one) and math.isfinite(one) for one in numbers)


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
        z = node_values(returned.z, mesh, "the adjoint")
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
    own = returned.error
    estimated = _error(returned, u.ravel(), float(value), mesh, goal) if own is None else float(own)
    is_point = bool(np.count_nonzero(weights) <= POINT_NODES)
    return GoalValues(u=u, z=z, value=float(value), error=estimated, is_point=is_point)


def _error(returned: WithAdjoint, u: Array, value: float, mesh: HasParts, goal: Goal) -> float | None:
    """What ``value`` lacks of the functional of a solution of degree 2; ``None`` where its equation is not known."""
    ties = getattr(mesh, "ties", None)  # nodes that are one unknown, of a domain that is closed
    is_own = goal.places is None and goal.flux_side is None
    if is_own or goal.source is None or goal.diffusion is None or np.size(ties if ties is not None else ()):
        return None
    parts = mesh.mesh_parts("quad")
    equation = Equation(diffusion=goal.diffusion, stream=goal.stream, reaction=goal.reaction, source=goal.source)
    is_fixed = ~_free_nodes(returned.fixed, u.size)
    if not (is_fixed.any() or goal.reaction):
        raise BadValues("no node has a given value, so that the equation has many solutions: name them in fixed")
    of = str(goal.flux_side) if goal.places is None else goal.places
    return functional_of_degree_2(parts, equation, of, u, is_fixed) - value


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


def _free_nodes(fixed: Any, count: int) -> BoolArray:
    """Whether each node is none of the ``fixed`` ones, which are numbers or a mask."""
    is_free = np.ones(count, dtype=bool)
    try:
        is_free[np.asarray(fixed) if np.size(fixed) else []] = False
    except (IndexError, TypeError, ValueError) as error:
        raise BadValues(f"fixed names no nodes of this mesh ({error}): give their numbers, or a mask") from error
    return is_free
