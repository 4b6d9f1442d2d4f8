"""The history of a Schwarz iteration, as a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from equimesh_client.records.tables import Array, aligned, number, real_or_nan

# What a table of a Schwarz iteration tells of the subdomains: of so many one by one, and of all in words.
COUNTS, MOST_TERMS = ("newton_steps", "sweeps"), 4


REMARKS = {"accelerated": "accelerated", "global_step": "global step"}


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """The Schwarz iteration: one entry of ``iterations`` for each, the initial mesh first (empty on a single
    domain), the observed ``rate`` of decrease per iteration and the ``predicted_rate``, None where unknown.
    """

    iterations: tuple[Mapping[str, Any], ...]
    rate: float | None
    predicted_rate: float | None
    record: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Convergence:
        """The convergence in the JSON of the service."""
        return cls(
            iterations=tuple(record.get("iterations") or ()),
            rate=record.get("rate"),
            predicted_rate=record.get("predicted_rate"),
            record=record,
        )

    def column(self, name: str) -> Array:
        """One figure of every iteration: ``max_q_eq``, ``change``, ``estimate``, ``deviation``, ``mismatch``,
        ``error``, ``min_jacobian``, ``work``, ``traffic``; nan where absent.
        """
        return np.array([real_or_nan(row.get(name)) for row in self.iterations])

    def table(self) -> str:
        """The iterations as an aligned text table."""
        if not self.iterations:
            return "one domain: no Schwarz iteration"
        known = ("max_q_eq", "change", "estimate", "error", "min_jacobian")
        figures = [name for name in known if not np.isnan(self.column(name)).all()]
        counts = {name.replace("_", " "): [_counted(row, name) for row in self.iterations] for name in COUNTS}
        counts = {name: said for name, said in counts.items() if any(said)}
        remarks = [_remark(*pair) for pair in zip(self.iterations, [{}, *self.iterations], strict=False)]
        rows = [
            [str(row.get("iteration", n)), *(number(real_or_nan(row.get(name))) for name in figures)]
            + [said[n] for said in counts.values()]
            + ([remarks[n]] if any(remarks) else [])
            for n, row in enumerate(self.iterations)
        ]
        text = aligned(["iteration", *figures, *counts, *(["remark"] if any(remarks) else [])], rows)
        rates = [("observed rate", self.rate), ("predicted rate", self.predicted_rate)]
        said = [f"{name} {number(value)}" for name, value in rates if value is not None]
        return text + ("\n" + ", ".join(said) if said else "")

    def __str__(self) -> str:
        return self.table()


def _counted(row: Mapping[str, Any], name: str) -> str:
    """Steps of the subdomains, e.g. ``4+3``, or of many ``16 x 1`` or ``54 in all``; empty where there are none."""
    found = [int(part.get(name) or 0) for part in row.get("subdomains") or ()]
    if not any(found):
        return ""
    if len(found) <= MOST_TERMS:
        return "+".join(map(str, found))
    return f"{len(found)} x {found[0]}" if len(set(found)) == 1 else f"{sum(found)} in all"


def _remark(row: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    """What was done in an iteration beside its solves."""
    condition, statuses = row.get("transmission"), [part.get("status") for part in row.get("subdomains") or ()]
    told = [f"{condition} took over"] if condition != before.get("transmission", condition) else []
    told += [f"{statuses.count(word)} {word}" for word in ("classical", "stalled") if word in statuses]
    told += [word for key, word in REMARKS.items() if row.get(key)]
    told += [f"{row['products']} products"] if row.get("products") else []
    return ", ".join(told)
