"""A sequence of meshes in time on a domain in blocks: each step starts from the mesh before."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal, Unpack

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_field
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import describe_value
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.sequences.pursuit import (
    BlockPursuit,
    Earlier,
    Found,
    about_moves,
    blocks_between,
    cells_moved,
    displacement,
    gain_of,
    largest_jump,
    outrun_by,
    problem_with,
)
from equimesh.sequences.sequence import SMOOTHED, BlockStep, about_integrals, check_settings, require_untouched
from equimesh.solving.blocks import check_start
from equimesh.solving.solution import OnBlocks, Solution, SolveError
from equimesh.solving.solve import solve
from equimesh.solving.status import SolveArguments
from equimesh.transfers.mesh_values import MeshValues
from equimesh.transfers.transfer import carry, named

SEVERAL = (
    "u has several parts, and a mesh of blocks minimises the error of one function: give one of them, or one that"
    " has the features of all, such as a weighted sum"
)
"""Why several u are refused."""


class BlockSequence:
    """Meshes of one domain in blocks that follow a solution in time.

    The same as :class:`~equimesh.sequences.sequence.Sequence` on a grid: ``problem`` is a
    :class:`~equimesh.equations.problem.Problem`, whose monitor has the settings of all steps. The first mesh
    is that of ``solution``, or ``mesh``, a valid mesh with the cells of the domain; without both, the problem is
    solved. ``smoothing``, ``max_move``, ``outrun`` and ``options`` are those of that class; blocks have no ``schwarz``,
    ``mode`` and ``allow_relaxed``.

    Raises :class:`~equimesh.errors.InputError` for values that cannot be used, and as :func:`equimesh.solve`.
    """

    def __init__(
        self,
        problem: Problem[Blocks],
        *,
        solution: OnBlocks | Earlier | None = None,
        mesh: QuadMesh | None = None,
        smoothing: float = 0.0,
        max_move: float = 1.0,
        outrun: Literal["substeps", "refuse"] = "substeps",
        **options: Unpack[SolveArguments],
    ) -> None:
        if not (isinstance(problem, Problem) and in_blocks(problem)):
            raise InputError(
                f"problem is {describe_value(problem)}: give one whose domain has blocks, or take Sequence for a grid",
                field="problem",
            )
        check_settings(smoothing, max_move, outrun)
        if isinstance(solution, Solution) and mesh is not None:
            raise InputError("a solution has a mesh: give solution= or mesh=, and not both", field="mesh")
        self.problem = problem
        self.smoothing, self.max_move, self.outrun = smoothing, max_move, outrun
        defaults: SolveArguments = {"threads": 1}
        self._options: SolveArguments = {**defaults, **options}
        self._check = options.get("check", True)
        self._earlier = solution if isinstance(solution, Earlier) else None
        found = None if isinstance(solution, Earlier) else solution
        if found is None and mesh is None:
            found = solve(problem, **self._options)
        self.solution = found
        self.mesh = _first_mesh(problem, mesh if found is None else found.mesh)
        self._nodes = self.mesh.points.copy()
        self.number = 0

    def step(self, u: Any, fields: Mapping[str, Any] | None = None) -> BlockStep:
        """The next mesh, adapted to ``u``, with the ``fields`` of the mesh before on it.

        ``u`` is an array of shape ``(n,)`` at the nodes of :attr:`mesh`; a field, or the text of an expression; or a
        monitor that a :class:`~equimesh.equations.problem.Problem` takes, whose settings hold from now on. A
        field is an array at the nodes, carried by cubics, or a
        :class:`~equimesh.transfers.mesh_values.MeshValues`.

        A solve that fails, and a refused step, leave the sequence as it was. Raises
        :class:`~equimesh.solving.solution.SolveError` then, unless ``check`` is false, and
        :class:`~equimesh.errors.InputError` for values that cannot be used, and where the points of :attr:`mesh` were
        written into.
        """
        require_untouched(self.mesh.points, self._nodes)
        given = named({} if fields is None else fields)
        for name, field in given.items():
            field.on(self.mesh, name)  # what cannot be carried is refused before the solve
        is_monitor = callable(getattr(u, "metric", None))
        problem = replace(self.problem, monitor=u) if is_monitor else problem_with(self.problem, self._field(u))
        found = self._pursue(problem)
        if not found.solution.status.succeeded:
            return self._failed(found.solution, given)
        solution = self._smoothed(found.solution)
        moved = cells_moved(self.mesh, solution.mesh)
        self._refuse_outrun(moved)
        carried = carry(self.mesh, given, solution.mesh)
        step = BlockStep(
            number=self.number + 1,
            mesh=solution.mesh,
            solution=solution,
            fields=carried,
            velocity=displacement(self.mesh, solution.mesh),
            moved=moved,
            substeps=found.substeps,
            notes=(*self._about_moves(solution, moved), *about_integrals((self.mesh, solution.mesh), given, carried)),
        )
        if is_monitor:
            self.problem = problem
        self.solution, self.mesh = solution, solution.mesh
        self._nodes = solution.mesh.points.copy()
        self.number += 1
        return step

    def _field(self, u: Any) -> Field:
        """A function of x and y: ``u`` itself, the expression of a text, or nodal values as a field."""
        if isinstance(u, str) or callable(getattr(u, "evaluate", None)):
            return require_field(u, "u")
        if isinstance(u, Mapping) or (
            isinstance(u, tuple | list) and any(np.ndim(part) or _is_one(part) for part in u)
        ):
            raise InputError(SEVERAL, field="u")
        return QuadField(mesh=self.mesh, values=u)

    def _pursue(self, problem: Problem[Blocks]) -> Found[OnBlocks]:
        """The solution of a step."""
        earlier = self._earlier
        if self.solution is not None:
            earlier = Earlier(u=self.solution.problem.monitor.u, gain=gain_of(self.solution))
        pursuit = BlockPursuit(
            options=self._options,
            before=self.mesh,
            u=None if earlier is None else earlier.u,
            gain=math.nan if earlier is None else earlier.gain,
            max_move=self.max_move if self.outrun == "substeps" else math.inf,
        )
        return pursuit.solve(problem)

    def _smoothed(self, solution: OnBlocks) -> OnBlocks:
        """The solution with a share of the mesh before."""
        if self.smoothing == 0.0:
            return solution
        mesh = blocks_between(solution.problem.domain, self.mesh, solution.mesh, self.smoothing)
        if mesh is solution.mesh:
            return solution
        note = " ".join((*filter(None, [solution.note]), f"{SMOOTHED} (smoothing = {self.smoothing:g})."))
        return replace(solution, mesh=mesh, reference=mesh, note=note)

    def _refuse_outrun(self, moved: float) -> None:
        is_first = self.solution is None and self._earlier is None
        if self.outrun == "refuse" and not is_first and moved > self.max_move:
            raise outrun_by(moved, self.max_move)

    def _failed(self, solution: OnBlocks, given: Mapping[str, MeshValues]) -> BlockStep:
        """A step that keeps the mesh and the fields as they were."""
        if self._check:
            raise SolveError(solution.message, solution)
        return BlockStep.kept(self.number + 1, self.mesh, solution, given)

    def _about_moves(self, solution: OnBlocks, moved: float) -> Iterator[str]:
        """Sentences about the move of the nodes."""
        u = solution.problem.monitor.u
        jump = largest_jump(u.values, self.mesh.cells) if isinstance(u, QuadField) and u.mesh is self.mesh else 0.0
        yield from about_moves(self.mesh, solution.mesh, jump, moved, self.max_move)


def _is_one(part: Any) -> bool:
    """Whether this is a function or an array by itself."""
    return isinstance(part, str) or callable(getattr(part, "evaluate", None)) or np.ndim(part) > 0


def _first_mesh(problem: Problem[Blocks], mesh: object) -> QuadMesh:
    """The mesh that a sequence begins with; raises :class:`~equimesh.errors.InputError` for one of another domain."""
    if not isinstance(mesh, QuadMesh):
        raise InputError(
            f"a sequence cannot begin with {describe_value(mesh)}: give mesh= a QuadMesh of the domain, or solution="
            " the result of em.solve",
            field="mesh",
        )
    found = check_start(problem, mesh)
    return found if isinstance(found, QuadMesh) else problem.domain.mesh
