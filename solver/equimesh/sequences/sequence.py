"""A sequence of meshes on a grid that follows a solution, and its steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, Self, Unpack

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain, map_mesh, tied
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.nodal_field import HermiteField, NodalField
from equimesh.fields.on_domain import OnDomain, reference_on
from equimesh.fields.quad_field import QuadField
from equimesh.inputs import describe_value
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import prolong
from equimesh.numerics.types import Array
from equimesh.schwarz.settings import Schwarz
from equimesh.sequences.pursuit import (
    Earlier,
    Pursuit,
    StepSolution,
    about_moves,
    cells_moved,
    displacement,
    followed,
    gain_of,
    largest_jump,
    monitor_for,
    outrun_by,
    smoothed,
)
from equimesh.solving.certificate import Certificate
from equimesh.solving.solution import AnySolution, Solution, SolveError
from equimesh.solving.solve import check_start_on_blocks, solve
from equimesh.solving.status import SolveArguments, Status
from equimesh.transfers.integrals import integral
from equimesh.transfers.mesh_values import MeshValues
from equimesh.transfers.one_domain import MAX_ROUNDING, require_one_domain, require_valid
from equimesh.transfers.transfer import carry, named
from equimesh_coupling.display import draw_on, picture
from equimesh_schema.notebook import html_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# What a step says of the integrals of the fields that it carried.

# A relative change of an integral that deserves a sentence: rounding is far less.
MAX_SILENT_CHANGE = 1e-12


def about_integrals(
    meshes: tuple[Mesh, Mesh], given: Mapping[str, MeshValues], carried: Mapping[str, Array]
) -> Iterator[str]:
    """Sentences about integrals that were not kept, from the mesh before to the new one."""
    for name, field in given.items():
        change = _change(meshes[0], meshes[1], field, carried[name]) if field.transfer == "conservative" else 0.0
        if change > MAX_SILENT_CHANGE:
            yield (
                f"The integral of {name} changed by {change:.1e} of itself: straight edges cut a curved side"
                " differently in the two meshes, and the bounds leave no room for the difference."
            )


def _change(old: Mesh, new: Mesh, field: MeshValues, carried: Array) -> float:
    """The largest relative change of the integral of a component."""
    values, largest = np.asarray(field.values, dtype=float), 0.0
    for index in np.ndindex(*values.shape[len(old.node_shape) :]):
        before = integral(old, values[(..., *index)], field.location)
        size = integral(old, np.abs(values[(..., *index)]), field.location)
        after = integral(new, carried[(..., *index)], field.location)
        largest = max(largest, abs(after - before) / size if size > 0.0 else 0.0)
    return largest


# What a sequence begins with: its settings, and its first mesh.

OUTRUN = ("substeps", "refuse")
# The largest share of the mesh before in a mesh that is smoothed in time.
MAX_SMOOTHING = 0.9


def check_settings(smoothing: Any, max_move: Any, outrun: Any) -> None:
    """Raise :class:`~equimesh.errors.InputError` for settings that a sequence cannot have."""
    if not (_is_number(smoothing) and 0.0 <= smoothing <= MAX_SMOOTHING):
        raise InputError(f"smoothing = {smoothing!r}: the share lies between 0 and {MAX_SMOOTHING}", field="smoothing")
    if not (_is_number(max_move) and max_move > 0.0):
        raise InputError(f"max_move = {max_move!r}: a positive number of cells; 1 is usual", field="max_move")
    if outrun not in OUTRUN:
        raise InputError(f"outrun = {outrun!r}: choose 'substeps' or 'refuse'", field="outrun")


def first_mesh(begin: AnySolution | Mesh | None, domain: Domain | Blocks) -> tuple[Any, Any]:
    """The mesh of the domain that a sequence begins with, and the same mesh on the reference square.

    Raises :class:`~equimesh.errors.InputError` for what is no mesh and no solution, for a folded mesh, and for one of
    another domain.
    """
    mesh = begin.mesh if isinstance(begin, Solution) else begin
    if not isinstance(mesh, Mesh) or isinstance(domain, Blocks) == mesh.is_grid:
        raise InputError(
            f"a sequence cannot begin with {describe_value(begin)}: give mesh= an em.Mesh, of blocks that of a"
            " domain in blocks, or solution= the result of em.solve",
            field="mesh",
        )
    if isinstance(domain, Blocks):
        check_start_on_blocks(domain, mesh)
        return mesh, mesh
    if isinstance(begin, Solution):
        reference = begin.reference
    else:
        require_valid(mesh)
        reference = reference_on(mesh, domain)
    mesh = tied(mesh, domain)
    if not _is_of(domain, mesh, reference):
        raise InputError("the first mesh of a sequence must be one of the problem's domain", field="mesh")
    return mesh, reference


def _is_of(domain: Domain, mesh: Mesh, reference: Mesh) -> bool:
    """Whether a mesh is the image of its reference; where that was not found exactly, its sides decide."""
    extent = max(np.ptp(mesh.x), np.ptp(mesh.y))
    if mesh.distance(map_mesh(reference, domain)) <= MAX_ROUNDING * extent:
        return True
    try:
        require_one_domain(mesh, map_mesh(Mesh.uniform(mesh.grid), domain))
    except InputError:
        return False
    return True


def _is_number(value: object) -> bool:
    return isinstance(value, Real)


# One step of a sequence: its mesh, the fields on it, and how the nodes have moved.


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SequenceStep:
    """The result of :meth:`~equimesh.sequences.sequence.Sequence.step`."""

    number: int
    """1 for the first step."""
    mesh: Mesh
    """The mesh of the sequence after the step: the mesh of the solution, or the last good mesh if the solve failed.

    The next step begins with it: write into copies of its arrays only.
    """
    solution: Solution[Any]
    """The solve of this step, also a failed one."""
    fields: Mapping[str, Array]
    """The fields on the mesh, by their names."""
    velocity: Array | None
    """The displacement of every node in this step, shape ``(n_xi, n_eta, 2)``, on blocks ``(n, 2)``; ``None`` where the
    grid has changed.

    Divided by the time step it is the velocity of the mesh.
    """
    moved: float | None
    """The displacement in cells of the mesh before that 95 % of the nodes do not exceed; ``None`` as above."""
    substeps: int
    """The number of meshes that were computed on the way to this one, itself included."""
    notes: tuple[str, ...]
    """Sentences about this step alone: moves, and integrals that bounds did not allow to keep."""

    @classmethod
    def kept(cls, number: int, mesh: Mesh, solution: Solution[Any], given: Mapping[str, MeshValues]) -> Self:
        """The step of a solve that failed: it keeps the mesh and the fields as they were."""
        return cls(
            number=number,
            mesh=mesh,
            solution=solution,
            fields={name: field.on(mesh, name) for name, field in given.items()},
            velocity=np.zeros((*mesh.node_shape, 2)),
            moved=0.0,
            substeps=1,
            notes=("The solve failed: the mesh before and its fields are kept.",),
        )

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.mesh.node_shape))
        return f"<SequenceStep {self.number}: {size} points, {self.status}>"

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the mesh on ``axes`` of matplotlib, or on those of pyplot, with the error of each cell as its colour."""
        return draw_on(self.mesh, self._error, axes)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        facts = [("step", str(self.number)), ("points", " x ".join(map(str, self.mesh.node_shape)))]
        facts += [("status", self.status.sentence), ("meshes on the way", str(self.substeps))]
        if self.moved is not None:
            facts.append(("moved", f"{self.moved:.2g} cells (95 % of the nodes)"))
        if self.fields:
            facts.append(("fields", ", ".join(self.fields)))
        return html_of(self.certificate.headline, facts, self.warnings, picture(self.mesh, self._error))

    @property
    def _error(self) -> Array | None:
        """The error of every cell; ``None`` where the mesh is the one before."""
        return self.solution.against_uniform.adapted.error if self.solution.mesh is self.mesh else None

    @property
    def status(self) -> Status:
        """The end of the solve."""
        return self.solution.status

    @property
    def certificate(self) -> Certificate:
        """The certificate of the mesh of the solve."""
        return self.solution.certificate

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to read before the next step: the notes of the step and the warnings of the certificate."""
        return (*self.notes, *self.certificate.warnings)


# The begin of the note of such a mesh.
SMOOTHED = "The mesh keeps a share of the mesh before it"


class Sequence:
    """Meshes of one domain, with four sides or in blocks, that follow a solution in time.

    ``problem`` gives domain, grid and the monitor, whose settings hold for all steps. The first mesh is that of
    ``solution``, or ``mesh``, a valid mesh of the domain, with its cells on blocks; without both, the problem is
    solved. ``schwarz`` and ``options`` are arguments of :func:`equimesh.solve`: ``mode``, ``allow_relaxed``,
    ``threads`` (here 1), ``observe`` and ``check``.

    ``smoothing`` in [0, 0.9] is the share of the mesh before in each new mesh, so that meshes do not jitter where u is
    noisy or changes little; a front is then followed later, by about ``smoothing / (1 - smoothing)`` steps. It is
    less in a step that would fold a cell. Such a mesh does not solve the equations: its status is ``completed`` where
    the solve has ``converged``, and the estimates of its errors are ``None``.

    ``max_move`` is the move, in cells, that one step may take; ``outrun`` says what happens to a larger one.
    ``"substeps"`` tries a nested start, and meshes for u interpolated in time, where the measured error has risen, and
    takes the best. ``"refuse"`` raises, and keeps the mesh before. The first step from a given ``mesh``, which need not
    be adapted to any u, is not refused: ``warnings`` has its move.

    A worker that has a problem, the mesh before and the fields of one step calls
    ``Sequence(problem, schwarz, mesh=before, check=False, ...).step(problem.monitor, fields)``. Its ``solution`` may be
    an :class:`Earlier`, the record of the mesh before; without it, no step is refused or taken in substeps.

    Raises :class:`~equimesh.errors.InputError` for values that cannot be used, and as :func:`equimesh.solve`.
    """

    def __init__(
        self,
        problem: Problem[Any],
        schwarz: Schwarz | None = None,
        *,
        solution: Solution[Any] | Earlier | None = None,
        mesh: Mesh | None = None,
        smoothing: float = 0.0,
        max_move: float = 1.0,
        outrun: Literal["substeps", "refuse"] = "substeps",
        **options: Unpack[SolveArguments],
    ) -> None:
        if not isinstance(problem, Problem):
            raise InputError(f"problem is {describe_value(problem)}: give a Problem", field="problem")
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
        found: AnySolution | None = None if isinstance(solution, Earlier) else solution
        if found is None and mesh is None:
            found = solve(followed(problem), schwarz, **self._options)
        self.solution = found
        self._earlier = earlier
        self.mesh: Mesh
        self._reference: Mesh
        self.mesh, self._reference = first_mesh(mesh if found is None else found, problem.domain)
        self._nodes = self.mesh.points.copy()
        self.number = 0

    def step(
        self,
        u: Any,
        fields: Mapping[str, Any] | None = None,
        *,
        grid: Grid | None = None,
    ) -> SequenceStep:
        """The next mesh, adapted to ``u``, with the ``fields`` of the mesh before on it.

        ``u`` is an array at the nodes of :attr:`mesh`, shape ``(n_xi, n_eta)``, on blocks ``(n,)``; a field, or the
        text of an expression; a monitor that the domain can have, whose settings hold from now on; or on a grid several
        of these, in a mapping or a tuple, which are intersected. A field is an array at the nodes, carried by splines,
        on blocks by cubics, or a :class:`~equimesh.transfers.mesh_values.MeshValues`. ``grid`` changes the number of
        points, which blocks do not take.

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
        old: Any = self.mesh
        same = old.node_shape == solution.mesh.node_shape
        moved = cells_moved(old, solution.mesh) if same else None
        self._refuse_outrun(moved)
        u = monitor.u
        known = u.mesh_map if isinstance(u, NodalField) and _is_same(u.mesh, old) else None
        carried = carry(old, given, solution.mesh, known)
        notes = list(self._about_moves(solution, moved))
        notes += about_integrals((old, solution.mesh), given, carried)
        step = SequenceStep(
            number=self.number + 1,
            mesh=solution.mesh,
            solution=solution,
            fields=carried,
            velocity=displacement(old, solution.mesh) if same else None,
            moved=moved,
            substeps=found.substeps,
            notes=tuple(notes),
        )
        kept = problem.monitor if is_monitor else self.problem.monitor
        self.problem = replace(problem, monitor=kept)
        self.solution, self.mesh, self._reference = solution, solution.mesh, solution.reference
        self._nodes = solution.mesh.points.copy()
        self.number += 1
        return step

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the current mesh on ``axes``, or on those of pyplot, as :meth:`SequenceStep.plot` does."""
        drawn: Axes = self._shown.plot(axes)
        return drawn

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        found: str = self._shown._repr_html_()
        return found

    @property
    def _shown(self) -> Any:
        """The solution of the current mesh, or the mesh alone where it was given."""
        return self.mesh if self.solution is None else self.solution

    def _on_grid(self, grid: Grid | None) -> Any:
        """The reference mesh before, on the grid of the step; blocks have none."""
        before: Any = self._reference
        return before if grid is None or grid == before.grid else prolong(before, grid)

    def _pursue(self, problem: Problem[Any], before: Mesh) -> StepSolution:
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

    def _smoothed(self, solution: AnySolution, before: Mesh) -> AnySolution:
        """The solution with a share of the mesh before."""
        if self.smoothing == 0.0:
            return solution
        mesh, reference = smoothed(solution, before, self.smoothing)
        if mesh is solution.mesh:
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
        """Whether the next step is the first one from a mesh without a solution."""
        return self.solution is None and self._earlier is None

    def _refuse_outrun(self, moved: float | None) -> None:
        if self.outrun == "refuse" and not self._is_first and moved is not None and moved > self.max_move:
            raise outrun_by(moved, self.max_move)

    def _failed(self, solution: AnySolution, given: Mapping[str, MeshValues]) -> SequenceStep:
        """A step that keeps the mesh and the fields as they were."""
        if self._check:
            raise SolveError(solution.message, solution)
        return SequenceStep.kept(self.number + 1, self.mesh, solution, given)

    def _about_moves(self, solution: AnySolution, moved: float | None) -> Iterator[str]:
        """Sentences about the move of the nodes."""
        if moved is None:
            return
        if self.outrun == "refuse" and self._is_first and moved > self.max_move:
            yield (
                f"The mesh moved by {moved:.2g} cells in this step, more than max_move = {self.max_move:g}: the first"
                " step from a given mesh is not refused. Later ones are."
            )
        u, before = solution.problem.monitor.u, self.mesh
        if isinstance(u, OnDomain):
            u, before = u.reference, self._reference
        jump, is_far = 0.0, moved > self.max_move  # of others nothing is said
        if is_far and isinstance(u, NodalField | HermiteField | QuadField) and _is_same(u.mesh, before):
            jump = largest_jump(u.values, u.mesh.cells)
        yield from about_moves(self.mesh, solution.mesh, jump, moved, self.max_move)


def require_untouched(points: Array, before: Array) -> None:
    """Raise :class:`~equimesh.errors.InputError` where the nodes of a mesh are no longer at ``before``."""
    if not np.array_equal(points, before):
        raise InputError(
            "the mesh of this sequence was written into since its last step: write into copies, as"
            " step.mesh.x.copy(), and begin a new sequence",
            field="mesh",
        )


def _is_same(one: Any, other: Any) -> bool:
    """Whether two meshes of one kind have the same nodes."""
    if one is other or type(one) is not type(other):
        return one is other
    is_alike = one.node_shape == other.node_shape and one.cell_shape == other.cell_shape
    return is_alike and bool(one.distance(other) == 0.0)
