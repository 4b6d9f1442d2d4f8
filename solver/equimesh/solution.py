"""One call from a problem to its mesh, by a single-domain or a Schwarz solve."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from equimesh import remedies, single_domain
from equimesh.decomposition import Decomposition
from equimesh.errors import SolveError
from equimesh.mesh import Mesh
from equimesh.mesh_data import MeshData
from equimesh.problem import Problem
from equimesh.quality import Quality, measure
from equimesh.rates import predicted_rate
from equimesh.schwarz import Iteration, Schwarz, iterate, smallest_tolerance
from equimesh.single_domain import NewtonRecord
from equimesh.status import Status

Event: TypeAlias = NewtonRecord | Iteration
Observer: TypeAlias = Callable[[Event], None]

# Iterations over which the observed rate is taken.
RATE_WINDOW = 6


class Initial(StrEnum):
    """Where a solve starts: ``NESTED``, the solution on a grid half as fine; ``UNIFORM``, the uniform mesh."""

    NESTED = "nested"
    UNIFORM = "uniform"


@dataclass(frozen=True, kw_only=True)
class Solution:
    """A mesh, how it came about, and whether it is what was asked for.

    ``newton_steps`` (or chord sweeps) and ``residual`` (relative to the mean flux) are those of the finest grid of a
    single-domain solve, or summed and largest over the subdomains. ``iterations`` is empty for a single-domain solve.
    ``note`` says more of what happened, ``remedy`` what to try; it is empty when there is nothing to mend.
    """

    problem: Problem
    schwarz: Schwarz | None
    mesh: Mesh
    status: Status
    newton_steps: int
    residual: float
    iterations: tuple[Iteration, ...] = ()
    note: str = ""
    remedy: str = ""

    @property
    def message(self) -> str:
        """What happened, and what to try."""
        return " ".join(text for text in (self.status.sentence, self.note, self.remedy) if text)

    @cached_property
    def quality(self) -> Quality:
        """All quality measures of the mesh."""
        return measure(self.mesh, self.problem.monitor)

    @property
    def decomposition(self) -> Decomposition | None:
        """The subdomains of the Schwarz iteration."""
        return None if self.schwarz is None else self.schwarz.decompose(self.problem.grid)

    @property
    def rate(self) -> float | None:
        """Observed factor by which the error (else the change) falls in one Schwarz iteration."""
        floor = smallest_tolerance(self.problem.grid)
        return observed_rate([i.change if i.error is None else i.error for i in self.iterations], floor)

    @property
    def predicted_rate(self) -> float | None:
        """The rate that theory predicts, where there is one; see :func:`equimesh.rates.predicted_rate`."""
        if self.schwarz is None or self.decomposition is None:
            return None
        return predicted_rate(self.decomposition, self.schwarz)

    def convergence(self) -> dict[str, Any]:
        """The history of the Schwarz iteration as plain numbers, ``None`` where a number is not known."""
        return {
            "iterations": [_plain_iteration(record) for record in self.iterations],
            "rate": self.rate,
            "predicted_rate": self.predicted_rate,
        }

    def data(self) -> MeshData:
        """What a mesh file holds: nodes, u, Q_eq and the owner of every cell."""
        shape = (self.problem.grid.n_xi - 1, self.problem.grid.n_eta - 1)
        owner = np.zeros(shape, dtype=np.int64) if self.decomposition is None else self.decomposition.owner_of_cells()
        (u,) = self.problem.monitor.u.evaluate(self.mesh.x, self.mesh.y)
        return MeshData(mesh=self.mesh, u=u, q_eq=self.quality.q_eq.cells, subdomain=owner)


def solve(
    problem: Problem,
    schwarz: Schwarz | None = None,
    *,
    initial: Initial = Initial.NESTED,
    observe: Observer | None = None,
    check: bool = True,
) -> Solution:
    """The locally equidistributed mesh of ``problem``, by Schwarz iteration if ``schwarz`` is given.

    ``observe`` is called with every Newton step of a single-domain solve (also that of a nested start) and with every
    Schwarz iteration. Raises :class:`~equimesh.errors.SolveError`, which carries the partial solution, when the mesh is
    not what was asked for; with ``check=False`` the status says so instead. A folded mesh is never a success.
    """
    tell = observe if observe is not None else _ignore
    solution = _single_domain(problem, initial, tell) if schwarz is None else _schwarz(problem, schwarz, initial, tell)
    if check and not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


def observed_rate(errors: Sequence[float], floor: float) -> float | None:
    """Mean factor between successive errors, over the last ones that are above the ``floor`` of rounding."""
    usable = [e for e in errors if math.isfinite(e) and e > floor]
    tail = usable[-RATE_WINDOW - 1 :]
    return (tail[-1] / tail[0]) ** (1.0 / (len(tail) - 1)) if len(tail) > 1 else None


def _plain_iteration(record: Iteration) -> dict[str, Any]:
    return {
        "iteration": record.iteration,
        "max_q_eq": _plain(record.max_q_eq),
        "change": _plain(record.change),
        "estimate": _plain(record.estimate),
        "mismatch": _plain(record.mismatch),
        "error": _plain(record.error),
        "min_jacobian": _plain(record.min_jacobian),
        "subdomains": [
            {
                "subdomain": r.subdomain,
                "newton_steps": r.newton_steps,
                "status": "stalled" if r.stalled else "classical" if r.classical else "converged",
                "residual": _plain(r.residual),
                "error_x": _plain(r.error_x),
                "error_y": _plain(r.error_y),
            }
            for r in record.subdomains
        ],
    }


def _plain(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _ignore(event: Event) -> None:
    del event


def _single_domain(problem: Problem, initial: Initial, observe: Observer) -> Solution:
    record, nested = _last_newton_record(problem, initial, observe), initial is Initial.NESTED
    return Solution(
        problem=problem,
        schwarz=None,
        mesh=_on_grid(record.mesh, problem),
        status=_checked(Status.CONVERGED if record.converged else Status.NEWTON_FAILED, record.mesh),
        newton_steps=record.step,
        residual=record.residual,
        note="" if record.converged else _where_newton_failed(record, problem),
        remedy="" if record.converged else remedies.after_newton(problem, nested=nested, reached=record.a),
    )


def _last_newton_record(problem: Problem, initial: Initial, observe: Observer) -> NewtonRecord:
    start = Mesh.uniform(problem.grid) if initial is Initial.UNIFORM else None
    return _last(single_domain.iterate(problem, start), observe)


def _reference(problem: Problem, observe: Observer) -> NewtonRecord:
    """The single-domain solution to rounding: errors of the Schwarz iteration are measured down to that."""
    record = _last_newton_record(problem, Initial.NESTED, observe)
    return _last(single_domain.iterate(problem, record.mesh), observe) if record.converged else record


def _last(records: Iterable[NewtonRecord], observe: Observer) -> NewtonRecord:
    record = None
    for record in records:
        observe(record)
    if record is None:
        raise AssertionError("a single-domain solve yields at least its start")
    return record


def _schwarz(problem: Problem, schwarz: Schwarz, initial: Initial, observe: Observer) -> Solution:
    schwarz.decompose(problem.grid)  # refuse what does not fit before any work is done
    start = Mesh.uniform(problem.grid)
    if initial is Initial.NESTED:
        start = _nested_start(problem, observe)
    reference = None
    if schwarz.compare_single_domain:
        reference = _reference(problem, observe)
    known = reference.mesh if reference is not None and reference.converged else None
    records: list[Iteration] = []
    for record in iterate(problem, schwarz, start, known):
        records.append(record)
        observe(record)
        if record.meets(schwarz.tolerance) or record.iteration >= schwarz.max_iterations:
            break
    note = ""
    if reference is not None and known is None:
        note = "There is no single-domain solution to compare with: " + _where_newton_failed(reference, problem)
    return _finished(problem, schwarz, records, note, nested=initial is Initial.NESTED)


def _nested_start(problem: Problem, observe: Observer) -> Mesh:
    """The solution on a grid half as fine, interpolated."""
    coarser = single_domain.nested_grids(problem.grid)[-2:][0]
    if coarser == problem.grid:
        coarser = single_domain.halved(problem.grid)
    record = _last_newton_record(replace(problem, grid=coarser), Initial.NESTED, observe)
    return single_domain.prolong(record.mesh, problem.grid)


def _finished(problem: Problem, schwarz: Schwarz, records: Sequence[Iteration], note: str, *, nested: bool) -> Solution:
    last = records[-1]
    rescued = [record.iteration for record in records if any(r.classical for r in record.subdomains)]
    if rescued:
        note = (
            f"The {schwarz.transmission.name} condition did not lead to a solution; classical data took its place in "
            f"{len(rescued)} of {last.iteration} iterations, first in iteration {rescued[0]}. {note}"
        ).strip()
    if last.failed:
        status = Status.NEWTON_FAILED
        stuck = ", ".join(str(r.subdomain) for r in last.subdomains if r.stalled)
        note = f"In iteration {last.iteration} Newton's method stalled for good in subdomain {stuck}. {note}".strip()
    elif schwarz.tolerance is None:
        status = Status.COMPLETED
    elif last.meets(schwarz.tolerance):
        status = Status.CONVERGED
        smallest = smallest_tolerance(problem.grid)
        if schwarz.tolerance < smallest:
            note = f"Rounding allows no tolerance below {smallest:.0e} on this grid; that was met. {note}".strip()
    else:
        status = Status.NOT_CONVERGED
        note = (
            f"In iteration {last.iteration} the estimated error is {_shown(last.estimate)}, and the subdomains differ "
            f"by {last.mismatch:.1e}. {note}"
        ).strip()
    solution = Solution(
        problem=problem,
        schwarz=schwarz,
        mesh=last.mesh,
        status=_checked(status, last.mesh),
        newton_steps=sum(r.newton_steps for record in records for r in record.subdomains),
        residual=max(r.residual for r in last.subdomains),
        iterations=tuple(records),
        note=note,
    )
    return replace(solution, remedy=_remedy(solution, nested=nested, rescued=bool(rescued)))


def _remedy(solution: Solution, *, nested: bool, rescued: bool) -> str:
    """What to try after a Schwarz iteration."""
    problem, schwarz, last = solution.problem, solution.schwarz, solution.iterations[-1]
    if schwarz is not None and solution.status is Status.NOT_CONVERGED:
        return remedies.after_schwarz(problem, schwarz, last, solution.rate, rescued=rescued)
    if solution.status is Status.NEWTON_FAILED:
        return remedies.after_newton(problem, nested=nested)
    return remedies.after_folding(problem, schwarz, nested=nested) if solution.status is Status.FOLDED else ""


def _shown(estimate: float) -> str:
    if math.isfinite(estimate):
        return f"{estimate:.1e}"
    return "not known yet" if math.isnan(estimate) else "not known, as the changes do not fall"


def _checked(status: Status, mesh: Mesh) -> Status:
    return Status.FOLDED if status.succeeded and mesh.is_folded else status


def _on_grid(mesh: Mesh, problem: Problem) -> Mesh:
    """The mesh on the problem's own grid, also where the solve ended on a coarser one."""
    return mesh if mesh.x.shape == problem.grid.shape else single_domain.prolong(mesh, problem.grid)


def _where_newton_failed(record: NewtonRecord, problem: Problem) -> str:
    way = "" if record.grid == problem.grid else f", on the way to {problem.grid} points,"
    return (
        f"On the {record.grid} grid{way} it stalled at a relative residual of {record.residual:.1e}; "
        f"a = {record.a:.3g} was reached."
    )
