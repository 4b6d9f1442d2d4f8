"""The records of Schwarz iterations, and the rates and errors that follow from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh
from equimesh.quality import measures
from equimesh.sweeps.verdict import error_left


@dataclass(frozen=True, kw_only=True)
class SubdomainRecord:
    """The record of one subdomain in one iteration."""

    subdomain: int
    """The number of the subdomain, from 0."""
    newton_steps: int
    """Newton steps of its solve; 0 where it was solved by sweeps."""
    residual: float
    """Residual of the local equations: relative to the mean flux, or the relative deviation before the last sweep."""
    sweeps: int = 0
    """Line corrections of its solve; 0 where it was solved by Newton's method."""
    stalled: bool = False
    """Whether no solution was found; the previous one is then kept."""
    classical: bool = False
    """Whether the subdomain took positions of neighbours, since Newton's method stalled with its condition."""
    error_x: float | None = None
    """Largest error of x against the single-domain solution, where that is known."""
    error_y: float | None = None
    """Largest error of y, likewise."""

    @property
    def numbers(self) -> tuple[float, ...]:
        """The record of the solve as plain numbers, for messages; :meth:`of` reads them."""
        return (
            float(self.newton_steps),
            self.residual,
            float(self.sweeps),
            float(self.stalled),
            float(self.classical),
        )

    @classmethod
    def of(cls, subdomain: int, numbers: Sequence[float]) -> SubdomainRecord:
        """The record of a subdomain from its :attr:`numbers`."""
        steps, residual, sweeps, stalled, classical = numbers
        return cls(
            subdomain=subdomain,
            newton_steps=int(steps),
            residual=residual,
            sweeps=int(sweeps),
            stalled=bool(stalled),
            classical=bool(classical),
        )


@dataclass(frozen=True, kw_only=True)
class IterationNumbers:
    """The record of one Schwarz iteration without its mesh, which several machines may hold.

    Iteration 0 is the start. Lengths are in units of the reference square.
    """

    iteration: int
    """The number of the iteration, from 0."""
    problem: Problem
    """The problem that is solved."""
    min_jacobian: float
    """The smallest corner Jacobian over the area of the domain: 1 for the uniform mesh of a rectangle."""
    change: float
    """The largest move of a coordinate in this iteration, NaN at the start."""
    estimate: float
    """The estimated error, from the contraction of line corrections or from the changes; NaN where not known."""
    mismatch: float
    """The largest difference between subdomains at nodes that they share.

    A fixed point without mismatch is the single-domain solution; one with a mismatch is not.
    """
    subdomains: tuple[SubdomainRecord, ...]
    """The records of the subdomains."""
    transmission: str
    """The name of the condition that was used: after a fallback, not the requested one."""
    deviation: float = math.nan
    """The largest relative deviation of a squared metric length from the mean of its line, before the last correction.

    A residual of the requested equations on the whole mesh; NaN without line corrections.
    """
    error: float | None = None
    """The largest error against the single-domain solution, where that is known."""
    global_step: bool = False
    """Whether a Newton step was taken on the whole grid: as a rescue, or to test a slow iteration."""
    accelerated: bool = False
    """Whether the mesh is a combination of several iterations, or a Newton step for their fixed point."""
    failed: bool = False
    """Whether a subdomain has stalled for good, which ends the iteration."""
    work: int = 0
    """The number of corrections of nodes."""
    traffic: int = 0
    """Bytes that the subdomains send each other, each on its own machine; see :mod:`equimesh.schwarz.iteration`."""
    products: int = 0
    """Products with the derivative of the iteration in a Newton step (RASPEN), each a solve in every subdomain.

    Neither ``work`` nor ``traffic`` counts them.
    """
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    def meets(self, tolerance: float | None) -> bool:
        """Whether the error is known to be at most ``tolerance``, or what rounding leaves where that is more.

        The estimate must be small enough, and the mesh must not be folded. Without line corrections, which test the
        equations on the whole mesh, all subdomains must also be solved, and differ by no more than such errors allow.
        """
        if tolerance is None:
            return False
        reachable = max(tolerance, smallest_tolerance(self.problem))
        if not (self.estimate <= reachable and self.min_jacobian > 0):
            return False
        agreed = self.mismatch <= 2 * reachable and not any(record.stalled for record in self.subdomains)
        return agreed or math.isfinite(self.deviation)


@dataclass(frozen=True, kw_only=True)
class Iteration(IterationNumbers):
    """The record of one Schwarz iteration with its mesh; iteration 0 is the start."""

    mesh: Mesh
    """The merged mesh on the physical domain."""
    reference: Mesh
    """The same mesh on the reference square."""

    @cached_property
    def max_q_eq(self) -> float:
        """The largest equidistribution measure of the mesh, equation (20) of the paper."""
        return float(measures.equidistribution(self.mesh, self.problem.monitor).max())


def estimate_error(changes: Sequence[float], rounding: float) -> float:
    """The remaining error if the changes continue to fall at the rate of the last ones; at least the last change.

    Where three changes are known the rate is taken over two iterations, in which data crosses a subdomain and comes
    back. Changes below ``rounding`` fall no more, so they have no rate.
    """
    change = changes[-1]
    if len(changes) < 3 or change <= rounding:
        return change if change <= rounding else math.nan
    before, over = (changes[-2], 1.0) if len(changes) == 3 else (changes[-3], 0.5)
    if change >= before:
        return math.inf
    rate: float = (change / before) ** over
    return change * max(1.0, error_left(1.0, rate))


# Iterations over which the observed rate is taken.
RATE_WINDOW = 6


def observed_rate(errors: Sequence[float], floor: float) -> float | None:
    """Mean factor between successive errors, over the last ones that are above the ``floor`` of rounding."""
    usable = [e for e in errors if math.isfinite(e) and e > floor]
    tail = usable[-RATE_WINDOW - 1 :]
    return (tail[-1] / tail[0]) ** (1.0 / (len(tail) - 1)) if len(tail) > 1 else None


def last_rate(problem: Problem, iterations: Sequence[IterationNumbers]) -> float | None:
    """The observed rate of the error, or else of the change, with the last condition of an iteration."""
    same = [i for i in iterations if i.transmission == iterations[-1].transmission]
    return observed_rate([i.change if i.error is None else i.error for i in same], smallest_tolerance(problem))


def plain(iterations: Sequence[Iteration], rate: float | None, predicted_rate: float | None) -> dict[str, Any]:
    """All iterations and the two rates as plain data for JSON: ``None`` where a number is not known."""
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
