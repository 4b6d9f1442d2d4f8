"""The history of a Schwarz iteration as numbers to look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from equimesh.schwarz.records import Iteration, SubdomainRecord

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
        "max_q_eq": _number(record.max_q_eq),
        "change": _number(record.change),
        "estimate": _number(record.estimate),
        "deviation": _number(record.deviation),
        "mismatch": _number(record.mismatch),
        "error": _number(record.error),
        "min_jacobian": _number(record.min_jacobian),
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
        "residual": _number(record.residual),
        "error_x": _number(record.error_x),
        "error_y": _number(record.error_y),
    }


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
