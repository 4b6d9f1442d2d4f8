"""The loop around a solver, without I/O: what each round requests, and what its answer tells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from equimesh_client.errors import BadArgument
from equimesh_client.records.measures import Array
from equimesh_client.spec.domains import Domain, has_own_points
from equimesh_client.spec.request import DEFAULT_POINTS, DEFAULTS, GenerateArguments, MeshOptions
from equimesh_client.wire.arrays import MeshArrays
from equimesh_coupling.adaptation import (
    MAX_UNRESOLVED_SHARE,
    Adaptation,
    AdaptRound,
    GoalRecord,
    ended,
    fault_of_solver,
    first_resolved,
    require_same_kind,
    verdict_on,
    wanted_density,
)
from equimesh_coupling.elements import MAX_DEGREES, WORDS, element_points
from equimesh_coupling.errors import BadValues
from equimesh_coupling.goals import NEEDS_GOAL, Goal, GoalValues, WithAdjoint, check_goal, goal_values
from equimesh_coupling.parts import Cells
from equimesh_coupling.recovery import ErrorIndicator, cell_values
from equimesh_coupling.values import element_values
from equimesh_schema import Certificate, Estimate
from equimesh_schema.document import is_whole
from equimesh_schema.mesh import MIN_GRID_POINTS, Target
from equimesh_schema.monitors import LeastError, NodalSolution, Norm, Weight

M = TypeVar("M")
"""The class of the meshes of the client."""
Solve: TypeAlias = Callable[[Any], Any]
"""A solver: from a mesh to what it returns on it."""
Observe: TypeAlias = Callable[[AdaptRound[Any]], None]
"""The function that is called with the record of every round."""
MAX_ROUNDS = 100
"""The most rounds that can be requested."""
NORMS = ("l2", "h1")
NO_INDICATOR = (
    "an error indicator says where cells are wanted, and equal shares of it need the lines of one grid, which blocks do"
    " not have: return values at the nodes, or CellAverages, from which the directions follow, too"
)
"""Why an error indicator is refused on blocks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RoundAnswer:
    """What a solver has returned on a mesh: ``values`` as arrays, and the ``monitor`` of the next mesh, if any."""

    arrays: MeshArrays
    values: Array
    is_indicator: bool
    monitor: NodalSolution | Weight | None
    u: object = None
    cells: Cells = "quad"
    """The cells of the elements at whose nodes values are."""
    dual: GoalValues | None = None
    """The adjoint and the functional, where there is a goal."""


@dataclass(kw_only=True)
class AdaptLoop(Generic[M]):
    """The rounds of :meth:`Client.adapt` that are done, and what follows from them.

    Raises :class:`BadArgument` for arguments that cannot be used.
    """

    solve: Solve
    n: int | tuple[int, int] | None
    """Points a side; None on blocks, which have their own."""
    domain: Domain | Mapping[str, Any] | None
    rounds: int
    norm: Norm | None
    """The norm of the error; None for "l2", and with a goal."""
    degree: int | None = None
    """The degree of the elements, 1 to 4; None: that of the space of a field, 1 for arrays."""
    cells: Cells | None = None
    """The cells of the elements, and of the meshes; None: those of the space of a field, quadrilaterals for arrays."""
    goal: Goal | None = None
    """The functional whose error meshes make small; None for the norm of the error."""
    tolerance: float | None = None
    """The estimated error of the functional at which the loop ends."""
    points: int | None = None
    """The most points of the whole mesh, whose shape is found; None where ``n`` or the domain gives it."""
    measured_norm: Norm = field(init=False)
    """The norm in which errors are measured."""
    is_settled: bool = False
    """Whether a round that resolves the solution has kept the shape of the mesh before."""
    first_resolved: object = None
    """The values of the first round that resolved the solution, as samples; None before."""
    done: list[AdaptRound[M]] = field(default_factory=list)
    moved_cells: float = 0.0
    """How far the nodes of the current mesh have moved."""
    start: str = "given"
    """The candidate that became the current mesh."""

    def __post_init__(self) -> None:
        if fault := fault_of_solver(self.solve):
            raise BadArgument(fault)
        if not is_whole(self.rounds) or not 1 <= self.rounds <= MAX_ROUNDS:
            raise BadArgument(f"rounds = {self.rounds!r}: a whole number between 1 and {MAX_ROUNDS}")
        if self.n is None and self.points is None and not has_own_points(self.domain):
            raise BadArgument("n is missing: give the number of points a side, or points, those of the whole grid")
        if self.n is not None and has_own_points(self.domain):
            raise BadArgument(
                "a domain in blocks has no two directions of points: leave n out for its own numbers of cells, or give"
                " points, those of the whole mesh"
            )
        if self.n is not None and self.points is not None:
            raise BadArgument("give either n, points a side, or points, those of the whole grid, whose shape is found")
        if self.points is not None and self.goal is not None:
            raise BadArgument("the shape of a grid is found for a norm of the error: with a goal give n, not points")
        least = 1 if has_own_points(self.domain) else MIN_GRID_POINTS  # the service knows that of blocks
        if self.points is not None and not (is_whole(self.points) and self.points >= least):
            raise BadArgument(f"points = {self.points!r:.20}: give a whole number, at least {least} in all")
        if self.norm not in (None, *NORMS):
            raise BadArgument(f"norm = {self.norm!r}: choose 'l2' or 'h1'")
        if self.cells not in (None, *MAX_DEGREES):
            raise BadArgument(f"cells = {str(self.cells)[:20]!r}: choose 'quad' or 'triangle'")
        most, where = MAX_DEGREES[self.cells or "quad"], "" if self.cells is None else f" on {WORDS[self.cells]}"
        if self.degree is not None and not (is_whole(self.degree) and 1 <= self.degree <= most):
            raise BadArgument(f"degree = {self.degree!r:.20}: give 1 to {most}, the degree of your elements{where}")
        try:
            check_goal(self.goal, self.tolerance, self.degree, norm=self.norm, cells=self.cells)
        except ValueError as error:
            raise BadArgument(str(error)) from error
        # Products of two errors are those of the gradients.
        self.measured_norm = self.norm or ("h1" if self.goal else "l2")

    @property
    def is_done(self) -> bool:
        """Whether the loop ends."""
        return verdict_on(self.done, self.rounds, self.measured_norm, self.tolerance).is_done

    def first(self) -> GenerateArguments:
        """The request for the uniform mesh, on blocks the initial one; of ``points`` in the shape of the domain."""
        return self._request("0", LeastError(), self.n, points=self.points)

    def receive(self, arrays: MeshArrays, returned: object) -> RoundAnswer:
        """What the solver has ``returned`` on the mesh with these ``arrays``.

        Raises :class:`~equimesh_coupling.errors.BadValues` where it cannot be used.
        """
        on_blocks, dual = arrays.x.ndim == 1, None
        if self.goal is not None:
            dual = goal_values(returned, arrays, self.goal)
            returned = dual.u
        elif isinstance(returned, WithAdjoint):
            raise BadValues(NEEDS_GOAL)
        if on_blocks and isinstance(returned, ErrorIndicator):
            raise BadValues(NO_INDICATOR)
        if not isinstance(returned, ErrorIndicator):
            values, degree, cells = element_values(returned, arrays, self.degree, self.cells)
            require_same_kind(self.done, is_indicator=False)
            nodes = element_points(arrays, degree, cells)
            x, y = (q.reshape(values.shape) for q in nodes.T)

            shape = {} if self.points is None else {"block_cells": np.array(_shape(arrays))}

            def samples(of: Array) -> object:
                return {"nodes": nodes, "values": of, **shape} if on_blocks else (x, y, of)

            adjoint = None if dual is None else samples(dual.z)
            earlier = self.first_resolved if (self.measured_norm, degree) == ("l2", 1) else None
            monitor = NodalSolution(norm=self.measured_norm, degree=degree, adjoint=adjoint, earlier=earlier)
            found: Any = {"arrays": arrays, "values": values, "cells": cells, "dual": dual}
            return RoundAnswer(is_indicator=False, monitor=monitor, u=samples(values), **found)
        indicator = cell_values(returned, arrays)
        require_same_kind(self.done, is_indicator=True)
        density = wanted_density(arrays.x, arrays.y, indicator, self.measured_norm)
        weight = None if density is None else Weight((arrays.x, arrays.y, density), map="gradient")
        return RoundAnswer(arrays=arrays, values=indicator, is_indicator=True, monitor=weight)

    def next(self, answered: RoundAnswer) -> GenerateArguments | None:
        """The request for the next mesh, whose certificate has the estimate; None where the indicator is zero."""
        if answered.monitor is None:
            return None
        if self.points is None:
            return self._request(answered.u, answered.monitor, self.n, answered.cells)
        if isinstance(answered.monitor, NodalSolution) and not self.is_settled:
            return self._request(answered.u, answered.monitor, None, answered.cells, points=self.points)
        n = None if answered.arrays.blocks else answered.arrays.x.shape
        return self._request(answered.u, answered.monitor, n, answered.cells)

    def add(self, mesh: M, answered: RoundAnswer, certificate: Certificate | None, after: MeshArrays | None) -> None:
        """A round is done: ``certificate`` and ``after`` are those of the next mesh, None where there is none."""
        known = None if answered.is_indicator or certificate is None else certificate.estimate
        self.done.append(
            AdaptRound(
                number=len(self.done),
                mesh=mesh,
                values=answered.values,
                estimate=float(np.linalg.norm(answered.values)) if known is None else known.l2,
                estimate_h1=None if known is None else known.h1,
                unresolved=None if known is None else known.unresolved,
                moved_cells=self.moved_cells,
                start=self.start,
                goal=self._functional(answered, known),
                adjoint=None if answered.dual is None else answered.dual.z,
            )
        )
        if known is not None and after is not None and known.unresolved <= MAX_UNRESOLVED_SHARE:
            self.is_settled = _shape(after) == _shape(answered.arrays)
        if self.first_resolved is None and first_resolved(self.done) is not None:
            self.first_resolved = answered.u
        if known is not None and certificate is not None:
            self.moved_cells, self.start = known.moved_cells, _chosen(certificate)
        elif after is not None:
            self.moved_cells, self.start = _moved_cells(answered.arrays, after), "weight"

    def _functional(self, answered: RoundAnswer, known: Estimate | None) -> GoalRecord | None:
        if self.goal is None or answered.dual is None:
            return None
        if known is None or known.products is None:
            raise BadArgument("this service knows no adjoint: leave the goal out, or install a newer service")
        return self.goal.record(answered.dual, known.products)

    def ended(self, failure: Exception | None = None) -> Adaptation[M]:
        """The result; ``failure`` is what ended the loop before its time."""
        return ended(self.done, self.rounds, self.measured_norm, failure, self.tolerance)

    def _request(
        self,
        u: object,
        monitor: LeastError | NodalSolution | Weight,
        n: Any,
        cells: Cells = "quad",
        *,
        points: int | None = None,
    ) -> GenerateArguments:
        target = None if points is None else Target(norm=self.measured_norm, max_points=points)
        options: MeshOptions = {**DEFAULTS, "monitor": monitor, "domain": self.domain, "target": target}
        n = DEFAULT_POINTS if n is None else n
        return GenerateArguments(u=u, n=n, options=options, cells=self.cells or cells)


def _shape(arrays: MeshArrays) -> list[list[int]]:
    """The numbers of cells along both directions, of a grid or of every block."""
    shapes = [block.shape for block in arrays.blocks.values()] or [arrays.x.shape]
    return [[n - 1 for n in shape] for shape in shapes]


def _chosen(certificate: Certificate) -> str:
    """The name of the candidate that became the next mesh; ``"kept"`` where it is the same mesh."""
    return next((str(one.settings.get("start")) for one in certificate.comparison if one.chosen), "kept")


def _moved_cells(before: MeshArrays, after: MeshArrays) -> float:
    """The root mean square of the moves of the nodes, in spacings of a uniform mesh of the same extents."""
    moves = []
    for one, other, n in ((before.x, after.x, before.x.shape[0]), (before.y, after.y, before.y.shape[1])):
        moves.append((other - one) * (n - 1) / (one.max() - one.min()))
    return float(np.sqrt(np.mean(moves[0] ** 2 + moves[1] ** 2)))
