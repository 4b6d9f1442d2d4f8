"""A sequence of meshes in time: each step adapts to u, starts from the mesh before, and carries fields along."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal, Unpack

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.domains.domain import map_mesh
from equimesh.equations.block_problem import BlockProblem
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.nodal_field import NodalField
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import prolong
from equimesh.numerics.types import Array
from equimesh.schwarz.settings import Schwarz
from equimesh.sequences.beginning import check_settings, first_mesh
from equimesh.sequences.between import mesh_between
from equimesh.sequences.following import monitor_for
from equimesh.sequences.integrals import about_integrals
from equimesh.sequences.moves import about_moves, cells_moved, displacement, largest_jump, outrun_by
from equimesh.sequences.pursuit import Earlier, Found, Pursuit, gain_of
from equimesh.sequences.sequence_step import SequenceStep
from equimesh.solving.options import SolveArguments
from equimesh.solving.solution import Solution, SolveError
from equimesh.solving.solve import solve
from equimesh.solving.status import Status
from equimesh.transfers.mesh_values import MeshValues
from equimesh.transfers.transfer import carry_closed, named

# The begin of the note of such a mesh.
SMOOTHED = "The mesh keeps a share of the mesh before it"
ON_BLOCKS = "a Sequence follows u on a grid: take BlockSequence(problem) for a domain in blocks"


class Sequence:
    """Meshes of one domain that follow a solution in time.

    ``problem`` gives domain, grid and the monitor, whose settings hold for all steps. The first mesh is that of
    ``solution``, or ``mesh``, a valid mesh of the domain; without both, the problem is solved. ``schwarz`` and
    ``options`` are those of :func:`equimesh.solve`: ``mode``, ``allow_relaxed``, ``threads`` (here 1), ``observe`` and
    ``check``.

    ``smoothing`` in [0, 0.9] is the share of the mesh before in each new mesh, so that meshes do not jitter where u is
    noisy or changes little; a front is then followed later, by about ``smoothing / (1 - smoothing)`` steps. It is
    less in a step that would fold a cell. Such a mesh does not solve the equations: its status is ``completed`` where
    that of the solve was ``converged``, and the estimates of its errors are ``None``.

    ``max_move`` is the move, in cells, that one step may take; ``outrun`` says what happens to a larger one.
    ``"substeps"`` tries a nested start, and meshes for u interpolated in time, where the measured error has risen, and
    takes the best. ``"refuse"`` raises, and keeps the mesh before; but the first step from a given ``mesh``, which need
    not be adapted to any u, is not refused, and ``warnings`` tells its move.

    A worker that has a problem, the mesh before and the fields of one step calls
    ``Sequence(problem, schwarz, mesh=before, check=False, ...).step(problem.monitor, fields)``. Its ``solution`` may be
    an :class:`Earlier`, what is known of the mesh before; without any, no step is refused or taken in substeps.

    Raises :class:`~equimesh.errors.InputError` for values that cannot be used, and as :func:`equimesh.solve`.
    """

    def __init__(
        self,
        problem: Problem,
        schwarz: Schwarz | None = None,
        *,
        solution: Solution | Earlier | None = None,
        mesh: Mesh | None = None,
        smoothing: float = 0.0,
        max_move: float = 1.0,
        outrun: Literal["substeps", "refuse"] = "substeps",
        **options: Unpack[SolveArguments],
    ) -> None:
        _require_grid(problem)
        check_settings(smoothing, max_move, outrun)
        if isinstance(solution, Solution) and mesh is not None:
            raise InputError("a solution has a mesh: give solution= or mesh=, and not both", field="mesh")
        self.problem = problem
        self.schwarz = schwarz
        self.smoothing, self.max_move, self.outrun = smoothing, max_move, outrun
        defaults: SolveArguments = {"threads": 1}
        self._options: SolveArguments = {**defaults, **options}
        self._check = options.get("check", True)
        earlier = solution if isinstance(solution, Earlier) else None
        solution = None if isinstance(solution, Earlier) else solution
        if solution is None and mesh is None:
            solution = solve(problem, schwarz, **self._options)
        self.solution = solution
        self._earlier = earlier
        self.mesh: Mesh
        self.mesh, self._reference = first_mesh(mesh if solution is None else solution, problem.domain)
        self._nodes = self.mesh.points
        self.number = 0

    def step(
        self,
        u: Any,
        fields: Mapping[str, Any] | None = None,
        *,
        grid: Grid | None = None,
    ) -> SequenceStep:
        """The next mesh, adapted to ``u``, with the ``fields`` of the mesh before on it.

        ``u`` is an array of shape ``(n_xi, n_eta)`` at the nodes of :attr:`mesh`; a field, or the text of an
        expression; a monitor of any kind, whose settings hold from now on; or several of these, in a mapping or a
        tuple, which are intersected. A field is an array at the nodes, carried by splines, or a
        :class:`~equimesh.transfers.mesh_values.MeshValues`. ``grid`` changes the number of points.

        A solve that fails, and a refused step, leave the sequence as it was: the mesh before is kept. Raises
        :class:`~equimesh.solving.solution.SolveError` then, unless ``check`` is false, and
        :class:`~equimesh.errors.InputError` for values that cannot be used, and where the arrays of :attr:`mesh` were
        written into.
        """
        require_untouched(self.mesh.points, self._nodes)
        given = named({} if fields is None else fields)
        for name, field in given.items():
            field.on(self.mesh, name)  # what cannot be carried is refused before the solve
        is_monitor = callable(getattr(u, "metric", None))
        monitor = monitor_for(self.problem.monitor, u, self.mesh)
        problem = replace(self.problem, monitor=monitor, grid=grid or self.problem.grid)
        before = self._on_grid(problem.grid)
        found = self._pursue(problem, before)
        if not found.solution.status.succeeded:
            return self._failed(found.solution, given)
        solution = self._smoothed(found.solution, before)
        same = problem.grid == self.mesh.grid
        moved = cells_moved(self.mesh, solution.mesh) if same else None
        self._refuse_outrun(moved)
        carried = carry_closed(self.mesh, given, solution.mesh, closed_of(problem.domain))
        step = SequenceStep(
            number=self.number + 1,
            mesh=solution.mesh,
            solution=solution,
            fields=carried,
            velocity=displacement(self.mesh, solution.mesh) if same else None,
            moved=moved,
            substeps=found.substeps,
            notes=(*self._about_moves(solution, moved), *about_integrals((self.mesh, solution.mesh), given, carried)),
        )
        kept = problem.monitor if is_monitor else self.problem.monitor
        self.problem = replace(problem, monitor=kept)
        self.solution, self.mesh, self._reference = solution, solution.mesh, solution.reference
        self._nodes = solution.mesh.points
        self.number += 1
        return step

    def _on_grid(self, grid: Grid) -> Mesh:
        """The reference mesh before, on the grid of the step."""
        return self._reference if grid == self._reference.grid else prolong(self._reference, grid)

    def _pursue(self, problem: Problem, before: Mesh) -> Found[Solution]:
        """The solution of a step."""
        earlier = self._earlier
        if self.solution is not None:
            earlier = Earlier(u=self.solution.problem.monitor.u, gain=gain_of(self.solution))
        pursuit = Pursuit(
            schwarz=self.schwarz,
            options=self._options,
            before=before,
            u=None if earlier is None else earlier.u,
            gain=math.nan if earlier is None else earlier.gain,
            max_move=self.max_move if self.outrun == "substeps" else math.inf,
        )
        return pursuit.solve(problem)

    def _smoothed(self, solution: Solution, before: Mesh) -> Solution:
        """The solution with a share of the mesh before."""
        if self.smoothing == 0.0:
            return solution
        reference = mesh_between(before, solution.reference, self.smoothing)
        mesh = map_mesh(reference, solution.problem.domain)
        if reference is solution.reference or mesh.is_folded:
            return solution
        return replace(
            solution,
            reference=reference,
            mesh=mesh,
            # The rest holds for the mesh of the solve, and not for this one.
            status=Status.COMPLETED if solution.status is Status.CONVERGED else solution.status,
            note=" ".join((*filter(None, [solution.note]), f"{SMOOTHED} (smoothing = {self.smoothing:g}).")),
            residual=math.nan,
            algebraic_error=None,
            discretization_error=None,
        )

    @property
    def _is_first(self) -> bool:
        """Whether the next step is the first one from a mesh of which nothing else is known."""
        return self.solution is None and self._earlier is None

    def _refuse_outrun(self, moved: float | None) -> None:
        if self.outrun == "refuse" and not self._is_first and moved is not None and moved > self.max_move:
            raise outrun_by(moved, self.max_move)

    def _failed(self, solution: Solution, given: Mapping[str, MeshValues]) -> SequenceStep:
        """A step that keeps the mesh and the fields as they were."""
        if self._check:
            raise SolveError(solution.message, solution)
        return SequenceStep.kept(self.number + 1, self.mesh, solution, given)

    def _about_moves(self, solution: Solution, moved: float | None) -> Iterator[str]:
        """Sentences about the move of the nodes."""
        if moved is None:
            return
        if self.outrun == "refuse" and self._is_first and moved > self.max_move:
            yield (
                f"The mesh moved by {moved:.2g} cells in this step, more than max_move = {self.max_move:g}: the first"
                " step from a given mesh is not refused. Later ones are."
            )
        u = solution.problem.monitor.u
        jump = largest_jump(u.values) if isinstance(u, NodalField) and _is_same(u.mesh, self.mesh) else 0.0
        yield from about_moves(self.mesh, solution.mesh, jump, moved, self.max_move)


def _require_grid(problem: object) -> None:
    if isinstance(problem, BlockProblem):
        raise InputError(ON_BLOCKS, field="problem")


def require_untouched(points: Array, before: Array) -> None:
    """Raise :class:`~equimesh.errors.InputError` where the nodes of a mesh are no longer at ``before``."""
    if not np.array_equal(points, before):
        raise InputError(
            "the mesh of this sequence was written into since its last step: write into copies, as"
            " step.mesh.x.copy(), and begin a new sequence",
            field="mesh",
        )


def _is_same(one: Mesh, other: Mesh) -> bool:
    return one is other or (one.grid == other.grid and one.distance(other) == 0.0)
