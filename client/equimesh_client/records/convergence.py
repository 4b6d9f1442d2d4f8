"""The history of a Schwarz iteration or of a descent, as a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from equimesh_client.records.tables import Array, align, number
from equimesh_schema.codec import real_or_nan

COUNTS = ("newton_steps", "sweeps")
"""Counts of each subdomain that the table shows."""
MAX_TERMS = 4
"""With more subdomains the table shows the sum of their counts."""
MIN_PREDICTED_RATE = 0.05
"""A smaller predicted rate is not shown: what the prediction leaves out, the coupling of grid lines, then decides."""
REMARKS = {"accelerated": "accelerated", "global_step": "global step"}


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """The history of the Schwarz iteration, or of the descent of a least-error solve.

    ``iterations`` starts with the initial mesh and is empty on a single domain. ``rate`` is the observed decrease per
    iteration, ``predicted_rate`` the theoretical one; None where unknown. ``descent`` has a row for each step of a
    least-error solve: ``level``, ``grid`` (on blocks ``points``), ``start``, ``step``, ``error``, ``gain``,
    ``distortion``, ``min_jacobian``.
    """

    iterations: tuple[Mapping[str, Any], ...]
    rate: float | None
    predicted_rate: float | None
    descent: tuple[Mapping[str, Any], ...] = ()
    record: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Convergence:
        """The convergence in the JSON of the service."""
        return cls(
            iterations=tuple(record.get("iterations") or ()),
            rate=record.get("rate"),
            predicted_rate=record.get("predicted_rate"),
            descent=tuple(record.get("descent") or ()),
            record=record,
        )

    def column(self, name: str) -> Array:
        """One figure of every iteration, or of every step of a descent, nan where absent.

        ``name`` is ``max_q_eq``, ``change``, ``estimate``, ``deviation``, ``mismatch``, ``error``, ``min_jacobian``,
        ``work`` or ``traffic``; of a descent ``error``, ``gain``, ``distortion`` or ``min_jacobian``.
        """
        return np.array([real_or_nan(row.get(name)) for row in self.iterations or self.descent])

    def table(self) -> str:
        """The iterations as an aligned text table; of a descent the last step on each grid."""
        if self.descent:
            return self._descent_table()
        if not self.iterations:
            return "one domain: no Schwarz iteration"
        known = ("max_q_eq", "change", "estimate", "error", "min_jacobian")
        figures = [name for name in known if not np.isnan(self.column(name)).all()]
        counts = {name.replace("_", " "): [_count_text(row, name) for row in self.iterations] for name in COUNTS}
        counts = {name: texts for name, texts in counts.items() if any(texts)}
        remarks = [_remark(*pair) for pair in zip(self.iterations, [{}, *self.iterations], strict=False)]
        rows = [
            [str(row.get("iteration", n)), *(number(real_or_nan(row.get(name))) for name in figures)]
            + [texts[n] for texts in counts.values()]
            + ([remarks[n]] if any(remarks) else [])
            for n, row in enumerate(self.iterations)
        ]
        text = align(["iteration", *figures, *counts, *(["remark"] if any(remarks) else [])], rows)
        predicted = self.predicted_rate if (self.predicted_rate or 0.0) >= MIN_PREDICTED_RATE else None
        rates = [("observed rate", self.rate), ("predicted rate", predicted)]
        known_rates = [f"{name} {number(value)}" for name, value in rates if value is not None]
        return "\n".join([text, ", ".join(known_rates)] if known_rates else [text])

    def _descent_table(self) -> str:
        last: dict[tuple[object, ...], Mapping[str, Any]] = {}
        for row in self.descent:
            last[_points_of(row), row.get("start")] = row
        rows = [
            [_points_of(row), str(row.get("start", "")), str(row.get("step", ""))]
            + [number(real_or_nan(row.get(name))) for name in ("error", "gain", "min_jacobian")]
            for row in last.values()
        ]
        return align(["grid", "start", "step", "error", "gain", "min_jacobian"], rows)

    def __str__(self) -> str:
        return self.table()


def _points_of(row: Mapping[str, Any]) -> str:
    """The points of a step of a descent: of a grid in both directions, of blocks in all."""
    return " x ".join(map(str, row.get("grid") or (row.get("points", ""),)))


def _count_text(row: Mapping[str, Any], name: str) -> str:
    """Steps of the subdomains, e.g. ``4+3``, or of many ``16 x 1`` or ``54 in all``; empty where there are none."""
    counts = [int(part.get(name) or 0) for part in row.get("subdomains") or ()]
    if not any(counts):
        return ""
    if len(counts) <= MAX_TERMS:
        return "+".join(map(str, counts))
    return f"{len(counts)} x {counts[0]}" if len(set(counts)) == 1 else f"{sum(counts)} in all"


def _remark(row: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    """The events of an iteration other than its solves."""
    condition, statuses = row.get("transmission"), [part.get("status") for part in row.get("subdomains") or ()]
    events = [f"{condition} took over"] if condition != before.get("transmission", condition) else []
    events += [f"{statuses.count(word)} {word}" for word in ("classical", "stalled") if word in statuses]
    events += [word for key, word in REMARKS.items() if row.get(key)]
    events += [f"{row['products']} products"] if row.get("products") else []
    return ", ".join(events)
