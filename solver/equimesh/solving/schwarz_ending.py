"""How a Schwarz iteration ended, from its records: the status, its details, and what to try."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.inputs import finite_or_none
from equimesh.schwarz.conditions import label
from equimesh.schwarz.rates import predicted_rate
from equimesh.schwarz.records import IterationNumbers, last_rate
from equimesh.schwarz.settings import Schwarz
from equimesh.solving import remedies
from equimesh.solving.solution import status_unless_folded
from equimesh.solving.status import Status


@dataclass(frozen=True, kw_only=True)
class SchwarzEnding:
    """How a Schwarz iteration ended; the fields are those of :class:`~equimesh.solving.solution.Solution`."""

    status: Status
    newton_steps: int
    residual: float
    detours: tuple[str, ...]
    note: str
    remedy: str
    algebraic_error: float | None


def ending_of(
    problem: Problem,
    schwarz: Schwarz,
    records: Sequence[IterationNumbers],
    tolerance: float | None,
    *,
    nested: bool,
    folded: bool,
) -> SchwarzEnding:
    """How the iteration with these ``records`` ended; ``tolerance`` is that of its error, ``None`` for a fixed number.

    ``nested`` tells whether it started from a mesh that was interpolated from a coarser grid, ``folded`` whether
    the last mesh is.
    """
    last, detours = records[-1], tuple(_detours(schwarz, records))
    notes = [*detours]
    if last.failed:
        status = Status.NEWTON_FAILED
        stuck = ", ".join(str(r.subdomain) for r in last.subdomains if r.stalled)
        what = f"the solve of subdomain {stuck}" if stuck else "the iteration"
        notes.insert(0, f"In iteration {last.iteration} {what} stalled for good.")
    elif tolerance is None:
        status = Status.COMPLETED
    elif last.meets(tolerance):
        status = Status.CONVERGED
        smallest = smallest_tolerance(problem)
        if tolerance < smallest:
            notes.insert(0, f"Rounding allows no tolerance below {smallest:.0e} on this grid; that was met.")
    else:
        status = Status.NOT_CONVERGED
        shown = f"In iteration {last.iteration} the estimated error is {_shown(last.estimate)}"
        notes.insert(0, f"{shown}, and the subdomains differ by {last.mismatch:.1e}.")
    status = status_unless_folded(status, folded=folded)
    return SchwarzEnding(
        status=status,
        newton_steps=sum(r.newton_steps + r.sweeps for record in records for r in record.subdomains),
        residual=max(r.residual for r in last.subdomains),
        detours=detours,
        note=" ".join(notes),
        remedy=_remedy(status, problem, schwarz, records, tolerance, nested=nested),
        algebraic_error=finite_or_none(max(last.estimate, smallest_tolerance(problem))),
    )


def _detours(schwarz: Schwarz, records: Sequence[IterationNumbers]) -> list[str]:
    """Sentences about deviations of the iteration from the request."""
    requested, found = label(schwarz.transmission), []
    rescued = [record.iteration for record in records if any(r.classical for r in record.subdomains)]
    if rescued:
        found.append(
            f"The {requested} condition did not lead to a solution; classical data took its place in {len(rescued)} of"
            f" {records[-1].iteration} iterations, first in iteration {rescued[0]}."
        )
    others = [record for record in records if record.transmission != requested]
    if others:
        first = others[0]
        found.append(
            f"The {requested} condition stalled; from iteration {first.iteration} on the {first.transmission} one took"
            " its place, from the start."
        )
    globally = [record.iteration for record in records if record.global_step]
    if globally:
        found.append(
            f"In iteration {', '.join(map(str, globally))} a Newton step was taken on the whole grid, as a subdomain"
            " had stalled, the merged mesh was folded, or the iteration was slow."
        )
    return found


def _remedy(
    status: Status,
    problem: Problem,
    schwarz: Schwarz,
    records: Sequence[IterationNumbers],
    tolerance: float | None,
    *,
    nested: bool,
) -> str:
    """The remedy after a Schwarz iteration; empty where none is needed."""
    if status is Status.NOT_CONVERGED:
        observed, predicted = last_rate(problem, records), predicted_rate(schwarz.decompose(problem.grid), schwarz)
        slowest = None if observed is None else max(observed, predicted or 0.0)
        return remedies.after_schwarz(problem, schwarz, records[-1], slowest, tolerance or 0.0)
    if status is Status.NEWTON_FAILED:
        return remedies.after_newton(problem, nested=nested)
    return remedies.after_folding(problem, schwarz, nested=nested) if status is Status.FOLDED else ""


def _shown(estimate: float) -> str:
    if math.isfinite(estimate):
        return f"{estimate:.1e}"
    return "not known yet" if math.isnan(estimate) else "not known, as the changes do not fall"
