"""The results of a finished mesh: the stored record, the history of the solve, and the certificate in sentences."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict

from pydantic import BaseModel, Field

import equimesh
from equimesh_schema import Relaxed
from equimesh_schema.certificate import compared
from equimesh_service.problems.problem import Problem

if TYPE_CHECKING:
    AnySolution: TypeAlias = equimesh.Solution[Any]
    """The solution on a grid, or on blocks."""


def summary_of(solution: AnySolution) -> dict[str, Any]:
    """The record of a solve as plain data: status, steps, residual, and the last Schwarz iteration."""
    convergence = solution.convergence()
    iterations = convergence["iterations"]
    last = iterations[-1] if iterations else {}
    return {
        "status": str(solution.status),
        "message": solution.message,
        "newton_steps": solution.newton_steps,
        "residual": solution.residual if solution.residual < float("inf") else None,
        "iterations": max(len(iterations) - 1, 0),
        "transmission": last.get("transmission"),
        "work": sum(record["work"] for record in iterations) if iterations else None,
        "traffic": sum(record["traffic"] for record in iterations) if iterations else None,
        "max_q_eq": last.get("max_q_eq"),
        "change": last.get("change"),
        "error": last.get("error"),
        "rate": convergence["rate"],
        "predicted_rate": convergence["predicted_rate"],
    }


def problem_of(solution: AnySolution, *, is_kept: bool = True) -> Problem:
    """The problem of a solve that failed; its remedy names the partial mesh where the service keeps that."""
    download = " The partial mesh downloads with ?partial=true." if is_kept and not solution.mesh.is_folded else ""
    detail = solution.note or solution.status.sentence  # the title of the problem already tells the status
    if _is_refused(solution):
        detail = f"A relaxed mesh was found, and refused because allow_relaxed is false. {detail}"
    return Problem(str(solution.status).replace("_", "-"), detail, remedy=solution.remedy + download)


def _is_refused(solution: AnySolution) -> bool:
    """Whether a mesh of relaxed equations was found that ``allow_relaxed`` would make a success."""
    failed, relaxed = solution.status is equimesh.Status.NEWTON_FAILED, solution.relaxed
    return failed and bool(relaxed) and all(part.reached > 0.0 for part in relaxed)


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

    iteration: int = Field(description="Its number; 0 is the start.")
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


# The names of errors by their norms.
ERRORS = {"l2": "The error of interpolating u", "h1": "The error of the gradient"}
SOLVER_ERRORS = {"l2": "A solver's error", "h1": "A solver's error of the gradient"}


class Sentence(TypedDict):
    """One sentence.

    Its tone is ``good`` or ``bad`` for how good the mesh is, ``warning`` for what to know before the mesh is used, and
    ``note`` for everything else.
    """

    tone: Literal["good", "bad", "warning", "note"]
    text: str


def sentences_of(
    certificate: Mapping[str, Any],
    norm: str = "l2",
    error: Mapping[str, Any] | None = None,
    *,
    before: Literal["uniform", "initial"] = "uniform",
) -> list[Sentence]:
    """Sentences: the reason of a failure, the gain of the mesh, and every relaxation and warning of its certificate.

    The gain is measured in ``norm``, ``"l2"`` or ``"h1"``. ``error`` is the problem of a failed solve. Grids are
    compared with the uniform mesh, blocks with their initial one: ``before`` is the word for it.
    """
    return [
        *_about_failure(error),
        *_about_gain(certificate, norm, before),
        *_about_request(certificate),
        *_notes(certificate),
    ]


def _about_failure(error: Mapping[str, Any] | None) -> Iterator[Sentence]:
    if error is not None:
        yield {"tone": "bad", "text": f"{error['title']}. {error['detail']} {error['remedy']}"}


def _about_gain(certificate: Mapping[str, Any], norm: str, before: str) -> Iterator[Sentence]:
    gains = certificate["interpolation_gain"]
    if gains is None:
        yield {"tone": "note", "text": "There is no u, so no interpolation error is measured."}
        return
    interpolation, solver = gains[norm], (certificate.get("solver_gain") or {}).get(norm)
    names, gain = (SOLVER_ERRORS, solver) if solver else (ERRORS, interpolation)
    if not gain:
        return  # a warning or the failure says why it is not known
    one = "the initial" if before == "initial" else "a uniform"
    name, degree = names[norm], certificate.get("degree", 1)
    if degree > 1:
        name = f"{name} by elements of degree {degree}"
    here, word = compared(gain)
    if word == "as":
        yield {"tone": "note", "text": f"{name} is that of the {before} mesh."}
    else:
        yield {"tone": "good" if gain > 1.0 else "bad", "text": f"{name} is {here} than on {one} mesh."}


def _about_request(certificate: Mapping[str, Any]) -> Iterator[Sentence]:
    """Whether a requested error was reached, which monitor was chosen, and how formulas were understood."""
    target = certificate.get("target")
    if target is not None:
        (n_xi, n_eta), requested, reached = target["grid"], target["error"], target["reached"]
        is_reached = reached <= requested
        text = f"An error of {requested:.2g} was requested, and {n_xi} x {n_eta} points have {reached:.2g}."
        yield {"tone": "good" if is_reached else "bad", "text": text}
    chosen = next((one for one in certificate.get("comparison", ()) if one["chosen"]), None)
    if chosen is not None and chosen["kind"] != "nodal_solution":
        name = chosen["kind"].replace("_", " ")
        yield {"tone": "note", "text": f"Of the monitors that were compared, {name} was chosen."}
    for place, text in certificate.get("understood", {}).items():
        yield {"tone": "note", "text": f"What was typed was read as {place.rpartition('.')[2]} = {text}."}


def _notes(certificate: Mapping[str, Any]) -> Iterator[Sentence]:
    """Relaxations that no warning names, and the warnings."""
    warnings = certificate["warnings"]
    for entry in certificate["relaxed"]:
        relaxed = str(Relaxed(**entry))
        if not any(relaxed in warning for warning in warnings):
            yield {"tone": "note", "text": f"Relaxed: {relaxed}."}
    for warning in warnings:
        yield {"tone": "warning", "text": warning}
