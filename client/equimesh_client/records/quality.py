"""The quality measures of a mesh, as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from equimesh_client.records.tables import Array, align, number
from equimesh_schema.codec import real_or_nan


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
