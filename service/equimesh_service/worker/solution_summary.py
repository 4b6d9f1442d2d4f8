"""What a mesh says of its solve: the record that it stores, and the problem of a failed one."""

from typing import Any, TypeAlias

import equimesh
from equimesh_service.problems.problem import Problem

AnySolution: TypeAlias = equimesh.Solution | equimesh.BlockSolution
"""The solution on a grid, or on blocks."""


def summary_of(solution: AnySolution) -> dict[str, Any]:
    """The record of a solve as plain data: status, steps, residual, and the last Schwarz iteration."""
    convergence = solution.convergence()
    iterations = convergence["iterations"]
    last = iterations[-1] if iterations else {}
    steps, residual = len(solution.descent), float("inf")  # blocks have no equations to solve
    if isinstance(solution, equimesh.Solution):
        steps, residual = solution.newton_steps, solution.residual
    return {
        "status": str(solution.status),
        "message": solution.message,
        "newton_steps": steps,
        "residual": residual if residual < float("inf") else None,
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
