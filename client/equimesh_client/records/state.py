"""What the service says of a mesh: state and progress, quality, convergence, the arrays, pictures."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import DownloadDamaged
from equimesh_client.records.certificate import Certificate
from equimesh_client.records.tables import aligned, number

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
FINISHED = frozenset({"succeeded", "failed", "canceled"})
SIDES = ("left", "right", "bottom", "top")
# What a table of a Schwarz iteration tells of the subdomains: of so many one by one, and of all in words.
COUNTS, MOST_TERMS = ("newton_steps", "sweeps"), 4
REMARKS = {"accelerated": "accelerated", "global_step": "global step"}


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a mesh has come: ``stage`` in a word, ``fraction`` from 0 to 1, and the latest figures."""

    stage: str = ""
    iteration: int | None = None
    residual: float | None = None
    fraction: float = 0.0


def progress_of(record: Mapping[str, Any]) -> Progress:
    """The progress of a mesh resource; of a finished one the fraction is 1."""
    said = record.get("progress")
    said = said if isinstance(said, dict) else {}
    fraction = 1.0 if record.get("status") == "succeeded" else _real(said.get("fraction"))
    return Progress(
        stage=str(said.get("stage") or record.get("status") or ""),
        iteration=said["iteration"] if isinstance(said.get("iteration"), int) else None,
        residual=None if said.get("residual") is None else _real(said["residual"]),
        fraction=0.0 if math.isnan(fraction) else min(1.0, max(0.0, fraction)),
    )


class MeshState:
    """What is known of a mesh without asking again. ``record`` is the latest resource."""

    def __init__(self, record: Mapping[str, Any]) -> None:
        self.record: dict[str, Any] = dict(record)

    @property
    def id(self) -> str:
        """The name of the mesh at the service."""
        return str(self.record["id"])

    @property
    def status(self) -> str:
        """``queued``, ``running``, ``succeeded``, ``failed`` or ``canceled``."""
        return str(self.record.get("status", "queued"))

    @property
    def is_finished(self) -> bool:
        """Whether the status is final."""
        return self.status in FINISHED

    @property
    def progress(self) -> Progress:
        """How far it had come when the service was asked last."""
        return progress_of(self.record)

    @property
    def label(self) -> str | None:
        """The label it was asked for with."""
        return self.record.get("label")

    @property
    def error(self) -> dict[str, Any] | None:
        """The problem document of a failed mesh."""
        return self.record.get("error")

    @property
    def reused_from(self) -> str | None:
        """The mesh that this one has its files from, when the service had computed the same before; else None."""
        found = self.record.get("reused_from")
        return None if found is None else str(found)

    @property
    def certificate(self) -> Certificate | None:
        """How well it solves what was asked, once it is finished: ``print(mesh.certificate)``."""
        found = self.record.get("certificate")
        return Certificate.from_json(found) if isinstance(found, dict) else None

    @property
    def relaxed(self) -> bool:
        """Whether it is a valid mesh for a weaker or smoother monitor than asked; the certificate says which."""
        certificate = self.certificate
        return certificate is not None and certificate.status == "relaxed"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What its user should know, in sentences; empty when there is nothing."""
        certificate = self.certificate
        return () if certificate is None else certificate.warnings

    @property
    def timings(self) -> dict[str, Any]:
        """When it was asked for, started, finished, and how long it took."""
        return self.record.get("timings") or {}

    @property
    def attempts(self) -> int:
        """How often a worker has started on it."""
        return int(self.record.get("attempts") or 0)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.id} {self.status}>"


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A measure over all cells; ``cells`` of shape ``(n_xi - 1, n_eta - 1)`` only when it was asked for."""

    max: float = math.nan
    min: float = math.nan
    mean: float = math.nan
    rms: float = math.nan
    cells: Array | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class Quality:
    """The quality of a mesh, dimensionless; nan for what the service does not report.

    Each of ``measures`` is an attribute, too: ``quality.q_eq.max``. ``record`` is the JSON it comes from.
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
                    **{key: _real(value.get(key)) for key in ("max", "min", "mean", "rms")},
                    cells=np.asarray(value["cells"], dtype=np.float64) if value.get("cells") is not None else None,
                )
                for name, value in record.items()
                if name != "interpolation_error" and isinstance(value, dict)
            },
            min_jacobian=_real(record.get("min_jacobian")),
            min_jacobian_over_mean=_real(record.get("min_jacobian_over_mean")),
            interpolation_error={name: _real(value) for name, value in errors.items()},
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
        text = [aligned(["measure", "min", "mean", "rms", "max"], rows)] if rows else []
        text.append(f"smallest corner Jacobian  {number(self.min_jacobian)}  (1 for the uniform mesh)")
        for norm in ("l2", "h1"):
            here, uniform = (self.interpolation_error.get(key) for key in (norm, f"{norm}_uniform"))
            if here is not None and uniform is not None:
                text.append(f"interpolation error {norm.upper()}    {number(here)}  (uniform mesh: {number(uniform)})")
        return "\n".join(text)

    def __str__(self) -> str:
        return self.table()


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
        return np.array([_real(row.get(name)) for row in self.iterations])

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
            [str(row.get("iteration", n)), *(number(_real(row.get(name))) for name in figures)]
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


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshArrays:
    """The mesh itself: ``x``, ``y`` and ``u`` of shape ``(n_xi, n_eta)``, ``u`` None where the monitor has none,
    ``cells`` counter-clockwise, ``(m, 4)``
    or for triangles ``(m, 3)``, ``q_eq`` and ``subdomain`` of the quadrilaterals, ``(n_xi - 1, n_eta - 1)``, which
    two successive triangles share, ``boundary``: edges ``(k, 2)`` of each side, the domain on their left,
    ``fields``: what was carried along with a step of a sequence, of the shape of ``u``.
    """

    x: Array
    y: Array
    u: Array | None
    cells: IntArray
    q_eq: Array
    subdomain: IntArray
    boundary: Mapping[str, IntArray]
    fields: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def points(self) -> Array:
        """Node coordinates, shape ``(n_xi * n_eta, 2)``."""
        return np.column_stack([self.x.ravel(), self.y.ravel()])


KNOWN = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES})


def arrays_of(npz: bytes) -> MeshArrays:
    """The arrays of an npz mesh file. Raises :class:`DownloadDamaged` when it is not one."""
    try:
        with np.load(io.BytesIO(npz), allow_pickle=False) as file:
            shape = (file["x"].shape[0] - 1, file["x"].shape[1] - 1)
            every = 2 if file["cells"].shape[1] == 3 else 1
            return MeshArrays(
                x=file["x"],
                y=file["y"],
                u=file.get("u"),
                cells=file["cells"].astype(np.int64),
                q_eq=file["q_eq"].ravel()[::every].reshape(shape),
                subdomain=file["subdomain"].ravel()[::every].reshape(shape).astype(np.int64),
                boundary={side: file[side].astype(np.int64) for side in SIDES},
                fields={name: file[name] for name in file.files if name not in KNOWN},
            )
    except (KeyError, ValueError, OSError, EOFError, IndexError) as error:
        raise DownloadDamaged(f"the npz file of the mesh cannot be read: {error}") from error


def _real(value: Any) -> float:
    """A float; nan for what is absent or is none."""
    return float(value) if isinstance(value, int | float) else math.nan
