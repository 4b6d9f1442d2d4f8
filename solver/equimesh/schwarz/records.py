"""What is known of one Schwarz iteration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_tolerance
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh
from equimesh.quality import measures


@dataclass(frozen=True, kw_only=True)
class SubdomainRecord:
    """What one subdomain did in one iteration.

    It was solved by ``sweeps`` line corrections, or ``newton_steps``. ``classical`` says that Newton's method stalled
    with the asked transmission condition, and that it took the neighbours' positions for this iteration; ``stalled``
    that nothing led to a solution, and the previous state was kept. ``residual`` is that of the local equations:
    relative to the mean flux, or of sweeps the largest relative deviation before the last one. ``error_x`` and
    ``error_y`` are against the single-domain solution, over the whole subdomain.
    """

    subdomain: int
    newton_steps: int
    residual: float
    sweeps: int = 0
    stalled: bool = False
    classical: bool = False
    error_x: float | None = None
    error_y: float | None = None


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """The state after one Schwarz iteration; iteration 0 is the start. ``mesh`` is that of the physical domain,
    ``reference`` the same on the reference square; all lengths are in units of the latter.

    ``change`` is the max norm by which the merged mesh moved (NaN at 0), ``estimate`` the error that is left, NaN
    where not known: as the line corrections contract, or else as the changes fall from iteration to iteration.
    ``deviation`` is the largest relative deviation of a squared metric length from the mean of its line, in the whole
    mesh before the last line correction (NaN without any): a residual of the asked equations. ``error`` is the one
    against the single-domain solution, where that is known. ``mismatch`` is the largest difference between subdomains
    at nodes that they share: a fixed point without mismatch is the single-domain solution, one with is not.

    ``transmission`` names the condition that was used, which is not the asked one after a fallback. ``global_step``
    says that a Newton step was taken on the whole grid, as a subdomain had stalled, the merged mesh folded, or a slow
    iteration was to be tested; ``accelerated`` that the mesh is a combination of several iterations, or a Newton step
    for their fixed point. ``failed`` ends the iteration: a subdomain has stalled for good. ``work`` is how many nodes
    were corrected, counted as often as they were, and ``traffic`` how many bytes the subdomains would send each other
    if each had a machine of its own. Neither counts ``products``: those with the derivative of the iteration in a
    Newton step (RASPEN), each a solve with the factors of every subdomain.
    """

    iteration: int
    problem: Problem
    mesh: Mesh
    reference: Mesh
    min_jacobian: float
    change: float
    estimate: float
    mismatch: float
    subdomains: tuple[SubdomainRecord, ...]
    transmission: str
    deviation: float = math.nan
    error: float | None = None
    global_step: bool = False
    accelerated: bool = False
    failed: bool = False
    work: int = 0
    traffic: int = 0
    products: int = 0

    @cached_property
    def max_q_eq(self) -> float:
        """The largest equidistribution measure of the mesh, equation (20) of the paper."""
        return float(measures.equidistribution(self.mesh, self.problem.monitor).max())

    def meets(self, tolerance: float | None) -> bool:
        """Whether the error is known to be at most ``tolerance``, or what rounding leaves where that is more.

        The estimate says so, and none is folded. Where no line corrections have tested the equations on the whole mesh,
        the subdomains must all have been solved, and agree as two meshes with such errors must.
        """
        if tolerance is None:
            return False
        reachable = max(tolerance, smallest_tolerance(self.problem))
        if not (self.estimate <= reachable and self.min_jacobian > 0):
            return False
        agreed = self.mismatch <= 2 * reachable and not any(record.stalled for record in self.subdomains)
        return agreed or math.isfinite(self.deviation)


def estimated(changes: Sequence[float], rounding: float) -> float:
    """The error left after changes that go on shrinking at the rate of the last ones, never less than the last change.

    The rate is that over two iterations where three changes are known, as data crosses a subdomain and comes back in
    two. Changes below ``rounding`` shrink no more, and say nothing of a rate.
    """
    change = changes[-1]
    if len(changes) < 3 or change <= rounding:
        return change if change <= rounding else math.nan
    before, over = (changes[-2], 1.0) if len(changes) == 3 else (changes[-3], 0.5)
    if change >= before:
        return math.inf
    rate: float = (change / before) ** over
    return change * max(1.0, rate / (1.0 - rate))


# Iterations over which the observed rate is taken.
RATE_WINDOW = 6


def observed_rate(errors: Sequence[float], floor: float) -> float | None:
    """Mean factor between successive errors, over the last ones that are above the ``floor`` of rounding."""
    usable = [e for e in errors if math.isfinite(e) and e > floor]
    tail = usable[-RATE_WINDOW - 1 :]
    return (tail[-1] / tail[0]) ** (1.0 / (len(tail) - 1)) if len(tail) > 1 else None


def plain(iterations: Sequence[Iteration], rate: float | None, predicted_rate: float | None) -> dict[str, Any]:
    """All iterations, and the two rates, as JSON has them: ``None`` where a number is not known."""
    return {
        "iterations": [_iteration(record) for record in iterations],
        "rate": rate,
        "predicted_rate": predicted_rate,
    }


def _iteration(record: Iteration) -> dict[str, Any]:
    return {
        "iteration": record.iteration,
        "transmission": record.transmission,
        "max_q_eq": finite_or_none(record.max_q_eq),
        "change": finite_or_none(record.change),
        "estimate": finite_or_none(record.estimate),
        "deviation": finite_or_none(record.deviation),
        "mismatch": finite_or_none(record.mismatch),
        "error": finite_or_none(record.error),
        "min_jacobian": finite_or_none(record.min_jacobian),
        "global_step": record.global_step,
        "accelerated": record.accelerated,
        "work": record.work,
        "traffic": record.traffic,
        "products": record.products,
        "subdomains": [_subdomain(r) for r in record.subdomains],
    }


def _subdomain(record: SubdomainRecord) -> dict[str, Any]:
    return {
        "subdomain": record.subdomain,
        "newton_steps": record.newton_steps,
        "sweeps": record.sweeps,
        "status": "stalled" if record.stalled else "classical" if record.classical else "converged",
        "residual": finite_or_none(record.residual),
        "error_x": finite_or_none(record.error_x),
        "error_y": finite_or_none(record.error_y),
    }
