"""The history of a Schwarz iteration or of a descent: its models, and its table in CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import BaseModel, Field


class SubdomainHistory(BaseModel):
    """The solve of one subdomain in one iteration."""

    subdomain: int = Field(description="Its number, from 0.")
    newton_steps: int = Field(description="Newton steps that solved it.")
    sweeps: int = Field(description="Line corrections that solved it, in place of Newton steps.")
    status: Literal["converged", "classical", "stalled"] = Field(
        description="classical: positions of its neighbours in place of the requested condition; stalled: not solved."
    )
    residual: float | None = Field(description="Of its own equations, relative.")
    error_x: float | None = Field(description="Error of x against the single domain, when that was requested.")
    error_y: float | None = Field(description="The same for y.")


class IterationHistory(BaseModel):
    """One Schwarz iteration; 0 is the start."""

    iteration: int
    transmission: str = Field(description="The condition in use; after a fallback, not the requested one.")
    max_q_eq: float | None = Field(description="Largest share of the metric of a cell; 1 where all are equal.")
    change: float | None = Field(description="Largest move of a node.")
    estimate: float | None = Field(description="Estimated error that is left; the tolerance is for it.")
    deviation: float | None = Field(
        description="Largest relative difference of a squared metric length from the mean of its grid line, before the "
        "last line correction; null without any."
    )
    mismatch: float | None = Field(description="Largest difference between subdomains at nodes that they share.")
    error: float | None = Field(description="Against the single domain, when that was requested.")
    min_jacobian: float | None
    global_step: bool = Field(description="Whether a Newton step was taken on the whole grid.")
    accelerated: bool = Field(description="Whether the mesh is a combination of several iterations.")
    products: int = Field(description="With the derivative of the iteration, in a step of acceleration newton.")
    work: int = Field(description="Corrected nodes, counted each time.")
    traffic: int = Field(description="Bytes that subdomains on machines of their own would have sent each other.")
    subdomains: list[SubdomainHistory]


class DescentHistory(BaseModel):
    """One step of a least-error solve."""

    level: int = Field(description="Number of the nested grid, 0 for the coarsest.")
    grid: tuple[int, int] | None = Field(None, description="Points of that grid along xi and eta; null of blocks.")
    points: int | None = Field(None, description="Points of a mesh of blocks on this level; null of a grid.")
    start: str = Field(description="The first mesh: uniform, rectilinear or given; of blocks initial.")
    step: int = Field(description="Number of the step on its grid; 0 for its first mesh.")
    error: float | None = Field(description="Interpolation error in the norm of the monitor.")
    gain: float | None = Field(
        description="Error of the uniform mesh, or of the initial one of blocks, over `error`; null where not measured."
    )
    distortion: float | None = Field(description="Mean distortion of the cells, 0 for the first mesh.")
    min_jacobian: float | None


class ConvergenceHistory(BaseModel):
    """The Schwarz iteration, or the descent of a least-error solve; without either for a single domain."""

    iterations: list[IterationHistory]
    descent: list[DescentHistory] = Field(default_factory=list, description="The steps of a least-error solve.")
    rate: float | None = Field(description="Observed factor of the error from one iteration to the next.")
    predicted_rate: float | None = Field(description="Factor that theory predicts; null where it predicts none.")


# The history of a single domain, which has no file.
NO_ITERATIONS: Mapping[str, Any] = {"iterations": [], "rate": None, "predicted_rate": None}
_DESCENT = ("level", "n_xi", "n_eta", "points", "start", "step", "error", "gain", "distortion", "min_jacobian")


def table(convergence: Mapping[str, Any]) -> str:
    """The history as CSV: one row for each iteration and subdomain, or for each step of a descent."""
    if convergence.get("descent"):
        return _descent_table(convergence["descent"])
    outer = [name for name in IterationHistory.model_fields if name != "subdomains"]
    inner = list(SubdomainHistory.model_fields)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(outer + inner)
    for iteration in convergence["iterations"]:
        for subdomain in iteration["subdomains"]:
            # Histories of meshes of earlier versions have fewer columns.
            cells = [iteration.get(name) for name in outer] + [subdomain.get(name) for name in inner]
            writer.writerow([str(cell).lower() if isinstance(cell, bool) else cell for cell in cells])
    return text.getvalue()


def _descent_table(records: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_DESCENT)
    for record in records:
        n_xi, n_eta = record.get("grid") or (None, None)
        points = n_xi * n_eta if n_xi and n_eta else record.get("points")
        row = {**record, "n_xi": n_xi, "n_eta": n_eta, "points": points}
        writer.writerow([row.get(name) for name in _DESCENT])
    return text.getvalue()
