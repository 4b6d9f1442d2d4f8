"""The solve of one step of a sequence: from the mesh before, and in smaller steps or from new starts if u moved far.

A descent from the mesh before takes less time than one from a uniform mesh, and has a larger error where a front moves
by more than a cell. The gain of the mesh shows that: the error on the uniform mesh over its own error. Where it has
fallen, a nested start is tried, and substeps with u interpolated in time. The smallest error decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import map_mesh
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_field
from equimesh.fields.nodal_field import NodalField
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.least_error import Auto, LeastError
from equimesh.monitors.metrics import Curvature
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.monitors.tensor import Intersection
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.solution import AnySolution
from equimesh.solving.solve import solve
from equimesh.solving.status import Initial, SolveArguments

# How far the nodes of a mesh move in a step: in cells, and whether all cells stay valid on the way.

# The share of nodes that move by at most the reported number of cells: a front occupies more than the rest of them.
NODE_SHARE = 0.95
# A change of u along one edge, as a share of its range, that deserves a sentence where the mesh moves far.
MAX_SILENT_JUMP = 0.5
# The share of rounding in the positions of nodes that meet on their way.
MEETING = 1e-12


def displacement(old: Mesh, new: Mesh) -> Array:
    """The displacement of every node, shape ``(n_xi, n_eta, 2)`` or ``(n, 2)``, in the unit of the coordinates.

    Divided by the time step it is the velocity of the mesh, for the ALE form of the equations.
    """
    return np.stack([new.x - old.x, new.y - old.y], axis=-1)


def cells_moved(old: Mesh, new: Mesh) -> float:
    """The displacement in cells that 95 % of the nodes do not exceed.

    The cells are those of the old mesh: a displacement is the sum of multiples of the half differences of neighbours
    along both lines through the node, and the larger multiple counts. On blocks it is the sum of multiples of the two
    edges of each cell at the node, and the mean over these cells counts.
    """
    if not old.is_grid:
        return float(np.quantile(_moved_in_cells(old, new.points - old.points), NODE_SHARE))
    move = displacement(old, new)
    (x_s, x_t), (y_s, y_t) = ((np.gradient(z, axis=0), np.gradient(z, axis=1)) for z in (old.x, old.y))
    with np.errstate(all="ignore"):  # where a Jacobian of differences vanishes, the node does not count
        det = x_s * y_t - x_t * y_s
        s = (move[..., 0] * y_t - move[..., 1] * x_t) / det
        t = (move[..., 1] * x_s - move[..., 0] * y_s) / det
        cells = np.maximum(np.abs(s), np.abs(t))
    return float(np.quantile(cells[np.isfinite(cells)], NODE_SHARE))


def _moved_in_cells(mesh: Mesh, move: Array) -> Array:
    """The displacement of each node in the cells of a mesh of blocks."""
    sums, counts = np.zeros(len(mesh.points)), np.zeros(len(mesh.points))
    for corner in range(4):
        node = mesh.cells[:, corner]
        a, b = (mesh.points[mesh.cells[:, (corner + step) % 4]] - mesh.points[node] for step in (1, 3))
        det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        s = (move[node, 0] * b[:, 1] - move[node, 1] * b[:, 0]) / det
        t = (move[node, 1] * a[:, 0] - move[node, 0] * a[:, 1]) / det
        sums += np.bincount(node, np.maximum(np.abs(s), np.abs(t)), len(sums))
        counts += np.bincount(node, minlength=len(sums))
    return np.asarray((sums / np.maximum(counts, 1.0))[counts > 0.0])


@compiled
def stays_valid(before: Array, after: Array, cells: IntArray) -> bool:
    """Whether ``cells`` are valid at all times while each node moves on a straight line at constant speed.

    The nodes are at ``before`` and ``after``, of shape ``(n, 2)``. A corner's Jacobian is quadratic in time, with the
    Bernstein coefficients a, m / 2 and b: it is positive throughout when a and b are, and m > -2 sqrt(a b).
    """
    for cell in cells:
        for corner in range(4):
            i, j, k = cell[corner - 1], cell[corner], cell[(corner + 1) % 4]
            x, y = before[j, 0] - before[i, 0], before[j, 1] - before[i, 1]
            to_x, to_y = before[k, 0] - before[j, 0], before[k, 1] - before[j, 1]
            x_end, y_end = after[j, 0] - after[i, 0], after[j, 1] - after[i, 1]
            to_x_end, to_y_end = after[k, 0] - after[j, 0], after[k, 1] - after[j, 1]
            a, b = x * to_y - y * to_x, x_end * to_y_end - y_end * to_x_end
            m = x * to_y_end - y * to_x_end + x_end * to_y - y_end * to_x
            if not (min(a, b) > 0.0 and m > -2.0 * (1.0 - MEETING) * math.sqrt(a * b)):
                return False
    return True


def largest_jump(values: Array, cells: IntArray) -> float:
    """The largest change of nodal values along one edge of ``cells``, as a share of their range; 0 for a constant."""
    whole, around = float(np.ptp(values)), values.reshape(-1)[cells]
    jump = float(np.abs(np.roll(around, 1, axis=1) - around).max())
    return jump / whole if whole > 0.0 else 0.0


def outrun_by(moved: float, max_move: float) -> InputError:
    """The refusal of a step in which the mesh would move by ``moved`` cells, more than ``max_move``."""
    return InputError(
        f"the mesh would move by {moved:.2g} cells in this step, more than max_move = {max_move:g}: u has outrun its"
        f" cells. Take {math.ceil(moved / max_move)} smaller time steps; the mesh before is kept",
        field="u",
    )


def about_moves(old: Mesh, new: Mesh, jump: float, moved: float, max_move: float) -> Iterator[str]:
    """Sentences about a step in which the mesh ``moved`` by so many cells; ``jump`` is the largest jump of its u."""
    if moved > max_move and jump > MAX_SILENT_JUMP:
        yield (
            f"The mesh moved by {moved:.2g} cells in this step, and u changes by {100 * jump:.0f} % of its range"
            " along one edge of the mesh before: it has outrun its cells there. Take smaller time steps."
        )
    if not stays_valid(old.points, new.points, old.cells):
        yield (
            "A cell would fold while its nodes move on straight lines from the mesh before to this one: take the"
            " carried fields, and not the velocity, in this step."
        )


# Interpolation between two times: of u, and of the mesh.

# Times, at most, that the share of the mesh before is halved until no cell is folded.
MAX_HALVINGS = 4


@dataclass(frozen=True, kw_only=True)
class Between:
    """``(1 - share) * earlier + share * later``: a function of x and y between two times, by linear interpolation.

    Implements :class:`~equimesh.fields.expression.Field`.
    """

    earlier: Field
    later: Field
    share: float

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its derivatives, as ``Field.evaluate``."""
        pairs = zip(self.earlier.evaluate(x, y, order), self.later.evaluate(x, y, order), strict=True)
        return tuple((1.0 - self.share) * one + self.share * other for one, other in pairs)


def smoothed(solution: AnySolution, before: Any, share: float) -> tuple[Any, Any]:
    """The mesh of a ``solution`` with a ``share`` of the mesh ``before``, and the same on the reference square.

    Where cells would fold, less of it, or the mesh of the solution itself.
    """
    domain = solution.problem.domain
    if isinstance(domain, Blocks):
        on_blocks = blocks_between(domain, before, solution.mesh, share)
        return on_blocks, on_blocks
    reference = mesh_between(before, solution.reference, share)
    mesh = map_mesh(reference, domain)
    is_same = reference is solution.reference or mesh.is_folded
    return (solution.mesh, solution.reference) if is_same else (mesh, reference)


def mesh_between(before: Mesh, new: Mesh, share: float) -> Mesh:
    """The ``new`` mesh of the reference square, with a ``share`` of the positions in the mesh ``before``.

    Where such a mesh is folded, the share is halved, and at last the new mesh is the result.
    """
    for _ in range(MAX_HALVINGS):
        mesh = Mesh(new.x + share * (before.x - new.x), new.y + share * (before.y - new.y))
        if not mesh.is_folded:
            return Mesh.of_unit_square(mesh.x, mesh.y)
        share *= 0.5
    return new


def blocks_between(domain: Blocks, before: Mesh, new: Mesh, share: float) -> Mesh:
    """The mesh between two meshes of a ``domain`` in blocks; nodes on curves are at their nearest points."""
    finest = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    for _ in range(MAX_HALVINGS):
        place = finest.of_points(new.points + share * (before.points - new.points))
        mesh = place.quad_mesh
        if not mesh.is_folded:
            return mesh
        share *= 0.5
    return new


# From what a time-stepper gives, u or a monitor, to the monitor of the next mesh.

# Radius of the smoothed curvature that stands for least error, in units of the domain's shorter extent.
SMOOTHING = 0.02


SEVERAL = (
    "u has several parts, and a mesh of blocks minimises the error of one function: give one of them, or one that"
    " has the features of all, such as a weighted sum"
)
"""The reason why several u are refused on blocks."""


def monitor_for(template: Monitor, given: Any, mesh: Mesh) -> Monitor:
    """The monitor of a step, with the settings of ``template``.

    ``given`` is a monitor, which is returned as it is; u as an array of the shape ``mesh.node_shape`` at the nodes of
    ``mesh``, as a field or as a text; or several of these in a mapping or a sequence. Of several u a monitor each is
    made, and these are intersected: cells are as small as any of them requests. In an intersection
    the smoothed curvature stands for least error and auto, which have no metric of their own.

    Raises :class:`~equimesh.errors.InputError` for a template without u, for values that cannot be used, and for
    several u on blocks.
    """
    if isinstance(given, type):
        raise InputError(f"u is the class {given.__name__}: give a monitor, such as LeastError(u=...)", field="u")
    if callable(getattr(given, "metric", None)):
        monitor: Monitor = given
        return monitor
    if isinstance(given, Mapping):
        return _several(template, [(f"u.{name}", part) for name, part in given.items()], mesh)
    if isinstance(given, Sequence) and not isinstance(given, str) and any(_is_whole(part, mesh) for part in given):
        return _several(template, [(f"u.{number}", part) for number, part in enumerate(given)], mesh)
    return with_u(template, field_of(given, mesh, "u"))


def followed(problem: Problem[Any]) -> Problem[Any]:
    """The problem of a mesh that is followed: of ``auto`` by the error of interpolation in place of a solver's.

    Meshes continue from the one before without a choice, and their gains of interpolation are compared.
    """
    monitor = problem.monitor
    if not (isinstance(monitor, Auto) and monitor.purpose == "finite_element"):
        return problem
    return replace(problem, monitor=replace(monitor, purpose="interpolation"))


def field_of(given: Any, mesh: Mesh, name: str) -> Field:
    """A function of x and y: ``given`` itself, the expression of a text, or nodal values as a field."""
    if given is None or isinstance(given, str) or callable(getattr(given, "evaluate", None)):
        return require_field(given, name)
    return QuadField(mesh=mesh, values=given) if not mesh.is_grid else NodalField(mesh=mesh, values=given)


def with_u(monitor: Monitor, u: Field) -> Monitor:
    """The monitor with another u: in its member where it is smoothed, in all members of an intersection."""
    names = {part.name for part in fields(monitor)} if _is_dataclass(monitor) else set()
    if isinstance(monitor, Intersection):
        return replace(monitor, monitors=tuple(with_u(member, u) for member in monitor.monitors))
    if "monitor" in names:
        inner: Any = monitor
        return _replaced(monitor, "monitor", with_u(inner.monitor, u))
    if "rho" in names:  # of a weight, the monitor is u itself
        return _replaced(monitor, "rho", u)
    if "u" in names and "m11" not in names:
        return _replaced(monitor, "u", u)
    raise InputError(
        f"a {type(monitor).__name__} follows no function u: give each step a monitor in its place", field="u"
    )


def _several(template: Monitor, given: Sequence[tuple[str, Any]], mesh: Mesh) -> Monitor:
    if len(given) == 1:
        return monitor_for(template, given[0][1], mesh)
    if not mesh.is_grid:
        raise InputError(SEVERAL, field="u")
    monitors = [
        part if callable(getattr(part, "metric", None)) else with_u(_metric(template), field_of(part, mesh, name))
        for name, part in given
    ]
    return Intersection(monitors=tuple(monitors))


def _metric(template: Monitor) -> Monitor:
    """The template, or a metric that stands for it."""
    if isinstance(template, LeastError | Auto):
        return Smoothed(monitor=Curvature(u=template.u, norm=template.norm), radius=SMOOTHING)
    return template


def _is_whole(part: Any, mesh: Mesh) -> bool:
    """Whether this is a u or a monitor by itself, and no row of an array."""
    return (
        isinstance(part, str)
        or any(callable(getattr(part, n, None)) for n in ("metric", "evaluate"))
        or (np.ndim(part) == len(mesh.node_shape))
    )


def _is_dataclass(monitor: object) -> TypeGuard[Any]:
    return is_dataclass(monitor)


def _replaced(monitor: Any, name: str, value: object) -> Monitor:
    other: Monitor = replace(monitor, **{name: value})
    return other


# A gain less than this share of that of the step before calls for a nested start, which costs as much again.
MIN_GAIN_SHARE = 0.8
# A gain less than this share of the one before, in spite of a nested start, calls for substeps.
MIN_GAIN_SHARE_WITHOUT_SUBSTEPS = 0.5
# Substeps, at most, of one step.
MAX_SUBSTEPS = 8


@dataclass(frozen=True, kw_only=True)
class StepSolution:
    """The solution of a step, and the number of meshes on the way to it."""

    solution: AnySolution
    substeps: int = 1

    @property
    def gain(self) -> float:
        """The error on the uniform or initial mesh over the error on this mesh; NaN where there is no error."""
        return gain_of(self.solution)


@dataclass(frozen=True, kw_only=True)
class Earlier:
    """The record of a mesh without its solution: its ``u``, or None, and its ``gain``, or NaN."""

    u: Field | None = None
    gain: float = math.nan


@dataclass(frozen=True, kw_only=True)
class Pursuit:
    """Finds the mesh of the next step. ``u`` is the u of the mesh ``before``, ``None`` where it is not known."""

    options: SolveArguments
    before: Mesh
    """The mesh before, on the reference square and the grid of the step; of blocks the mesh itself."""
    u: Field | None
    gain: float
    """The gain of the mesh before for its u; NaN where it is not known."""
    max_move: float
    schwarz: Schwarz | None = None

    def solve(self, problem: Problem[Any]) -> StepSolution:
        """The solution with the smallest measured error. Further starts are solved only where the gain has fallen."""
        problem = followed(problem)
        found = StepSolution(solution=self._from(problem, self.before))
        if isinstance(problem.monitor, Auto) and problem.monitor.purpose == "finite_volume":
            return found  # its meshes are chosen by another error than that of interpolation, and for each u anew
        # A mesh that has kept its gain is better than one that is a little better and far away.
        is_followed = not math.isnan(self.gain) or self._moved(found) <= self.max_move
        if is_followed and not self._has_lost(found, MIN_GAIN_SHARE):
            return found
        if isinstance(problem.monitor, LeastError | Auto) and self.schwarz is None:
            found = _better(found, StepSolution(solution=self._from(problem, Initial.NESTED)))
        if self._has_lost(found, MIN_GAIN_SHARE_WITHOUT_SUBSTEPS) and self._moved(found) > self.max_move:
            found = _better(found, self._in_substeps(problem, self._moved(found)))
        return found

    def _in_substeps(self, problem: Problem[Any], moved: float) -> StepSolution | None:
        """The solution by several meshes, each from the one before it; ``None`` where u is not known at both times."""
        later = problem.monitor.u
        if self.u is None or later is None or isinstance(problem.monitor, Intersection):
            return None  # the members of an intersection may have several u
        count = min(math.ceil(moved / self.max_move), MAX_SUBSTEPS)
        mesh = self.before
        for number in range(1, count):
            u = Between(earlier=self.u, later=later, share=number / count)
            try:
                between = replace(problem, monitor=with_u(problem.monitor, u))
            except InputError:
                return None
            solution = self._from(between, mesh)
            if not solution.status.succeeded:
                return None
            mesh = solution.reference
        return StepSolution(solution=self._from(problem, mesh), substeps=count)

    def _from(self, problem: Problem[Any], start: Mesh | Initial) -> AnySolution:
        """The solution from a start."""
        options: SolveArguments = {**self.options, "initial": start, "check": False}
        found: AnySolution = solve(problem, self.schwarz, **options)
        return found

    def _has_lost(self, found: StepSolution, share: float) -> bool:
        return not found.solution.status.succeeded or found.gain < share * self.gain

    def _moved(self, found: StepSolution) -> float:
        return cells_moved(self.before, found.solution.reference)


def gain_of(solution: AnySolution) -> float:
    """The gain of a mesh in the norm of its monitor; NaN where there is no u."""
    errors = solution.interpolation
    return math.nan if errors is None else errors.estimated_gain(getattr(solution.problem.monitor, "norm", "l2"))


def _better(one: StepSolution, other: StepSolution | None) -> StepSolution:
    """The solution with the larger gain. A failed solve loses against one that succeeded."""
    if other is None or not other.solution.status.succeeded:
        return one
    if not one.solution.status.succeeded or other.gain > one.gain:
        return other
    return one
