"""What the driver has of a solution in parts: everything but the rows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from equimesh.numerics.channel import Traffic
from equimesh.single_domain.steps import Mode
from equimesh.solving.status import Status
from equimesh_cluster.parts.part_solution import PartSolution, PartStep
from equimesh_schema import Relaxed


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One part without its rows. ``first`` and ``last`` are its own rows, as numbers of the grid."""

    first: int
    last: int
    mode: Mode
    status: Status
    newton_steps: int
    residual: float
    note: str
    remedy: str
    relaxed: tuple[Relaxed, ...]
    algebraic_error: float | None
    discretization_error: float | None
    records: tuple[PartStep, ...]


def summary_of(part: PartSolution) -> Summary:
    """The summary of a part. Runs where the part is."""
    return Summary(
        first=part.mesh.first,
        last=part.mesh.last,
        mode=part.mode,
        status=part.status,
        newton_steps=part.newton_steps,
        residual=part.residual,
        note=part.note,
        remedy=part.remedy,
        relaxed=part.relaxed,
        algebraic_error=part.algebraic_error,
        discretization_error=part.discretization_error,
        records=part.records,
    )


def traffic_of(summaries: Sequence[Summary]) -> dict[str, Traffic]:
    """The messages that all parts sent, and their bytes, by the kind of the message."""
    total: dict[str, Traffic] = defaultdict(Traffic)
    for summary in summaries:
        for record in summary.records:
            for kind, sent in record.traffic.items():
                total[kind].messages += sent.messages
                total[kind].bytes += sent.bytes
    return dict(total)
