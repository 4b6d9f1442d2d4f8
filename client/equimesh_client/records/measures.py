"""What a service has measured, as tables: the quality of a mesh, and the history of its iteration or descent."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_schema.document import real_or_nan

# Numbers as aligned text.

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]


def align(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A text table: first column to the left, the others to the right, a rule under the header."""
    widths = [max(len(line[n]) for line in (header, *rows)) for n in range(len(header))]
    lines = [
        "  ".join(
            [line[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))]
        ).rstrip()
        for line in (header, *rows)
    ]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def number(value: float | None) -> str:
    """A number in a few characters; ``-`` for none and nan."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4f}"
    return f"{value:.3e}"


# The quality measures of a mesh, as a table.


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A measure over all cells; ``cells`` of shape ``(n_xi - 1, n_eta - 1)`` only on request."""

    max: float = math.nan
    min: float = math.nan
    mean: float = math.nan
    rms: float = math.nan
    cells: Array | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class Quality:
    """The quality of a mesh, dimensionless; nan for what the service does not report.

    Each of ``measures`` is also an attribute: ``quality.q_eq.max``. ``record`` is the JSON of the service.
    """

    measures: Mapping[str, Measure]
    min_jacobian: float
    min_jacobian_over_mean: float
    interpolation_error: Mapping[str, float]
    record: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Quality:
        """The quality in the JSON of the service, or of ``equimesh``'s ``Quality.summary()``."""
        errors = record.get("interpolation_error") or {}
        return cls(
            measures={
                name: Measure(
                    **{key: real_or_nan(value.get(key)) for key in ("max", "min", "mean", "rms")},
                    cells=np.asarray(value["cells"], dtype=np.float64) if value.get("cells") is not None else None,
                )
                for name, value in record.items()
                if name != "interpolation_error" and isinstance(value, dict)
            },
            min_jacobian=real_or_nan(record.get("min_jacobian")),
            min_jacobian_over_mean=real_or_nan(record.get("min_jacobian_over_mean")),
            interpolation_error={name: real_or_nan(value) for name, value in errors.items()},
            record=record,
        )

    def __getattr__(self, name: str) -> Measure:
        measures: Mapping[str, Measure] = self.__dict__.get("measures", {})
        if name in measures:
            return measures[name]
        raise AttributeError(f"no measure {name!r}; there are {', '.join(measures)}")

    def table(self) -> str:
        """The measures as an aligned text table."""
        rows = [[n, number(m.min), number(m.mean), number(m.rms), number(m.max)] for n, m in self.measures.items()]
        text = [align(["measure", "min", "mean", "rms", "max"], rows)] if rows else []
        text.append(f"smallest corner Jacobian  {number(self.min_jacobian)}  (1 where all cells are equal)")
        for norm in ("l2", "h1"):
            here, uniform = (self.interpolation_error.get(key) for key in (norm, f"{norm}_uniform"))
            if here is not None and uniform is not None:
                text.append(
                    f"interpolation error {norm.upper()}    {number(here)}  (without adapting: {number(uniform)})"
                )
        return "\n".join(text)

    def __str__(self) -> str:
        return self.table()


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
