"""The certificate of a mesh: how well it solves the requested equations, and warnings."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import equimesh_schema
from equimesh.inputs import finite_or_none
from equimesh.quality.faces import Faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.single_domain.steps import Mode
from equimesh.solving.status import Status
from equimesh_schema import Aim, Candidate, Estimate, Relaxed


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """How well a mesh solves the requested equations, measured on the mesh itself wherever possible."""

    status: Status
    """How the solve ended."""
    mode: Mode | None
    """When a single-domain solve ends; ``None`` for a Schwarz iteration and for a gradient map."""
    equation_residual: float | None
    """The largest relative difference of a squared metric length from the mean of its grid line.

    It is the residual of the requested equations, also where relaxed ones were solved. It is 0 on their exact
    solution. For a gradient map it is the root mean square of the relative deviations of the cells' shares from their
    mean. ``None`` for a mesh that minimises the interpolation error, which solves no such equations.
    """
    min_jacobian: float
    """The smallest corner Jacobian: positive on every valid mesh, 1 on the uniform mesh of a rectangle.

    On a domain in blocks it is relative to the mean area of a cell.
    """
    faces: Faces
    """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
    discretization_error: float | None = None
    """Estimate of the largest error of a node's coordinate that the grid causes, in units of the reference square.

    ``None`` where it is not known.
    """
    algebraic_error: float | None = None
    """Estimate of the largest error from stopping the iteration, in the same units; ``None`` where it is not known."""
    relaxed: tuple[Relaxed, ...] = ()
    """The differences between the requested and the solved equations; empty where there are none."""
    warnings: tuple[str, ...] = ()
    """Sentences to read before using the mesh."""
    interpolation: InterpolationErrors | None = None
    """The errors of interpolating u on the mesh and on the uniform one; ``None`` where there is no u."""
    target: Aim | None = None
    """The requested interpolation error and what was reached; ``None`` where a grid was given."""
    comparison: tuple[Candidate, ...] = ()
    """The monitors that were compared on a coarse grid, the best one first; empty where the monitor was given."""
    estimate: Estimate | None = None
    """The estimated error of the values that a round of adapting was given; ``None`` for other meshes."""
    compared_with: Literal["uniform", "initial"] = "uniform"
    """The mesh that the gains of interpolation refer to: the uniform one, on a domain in blocks the initial one."""
    understood: Mapping[str, str] = field(default_factory=dict)
    """The formulas that were typed in another spelling, as they were understood: ``{"monitor.u": "2*x"}`` for 2x."""

    @property
    def resolved(self) -> bool:
        """Whether the gains of interpolation are known: two rules of quadrature agree, or there is no u."""
        return self.interpolation is None or all(self.interpolation.resolved)

    @property
    def document(self) -> equimesh_schema.Certificate:
        """The certificate as it is answered."""
        faces, gain = self.faces, self.interpolation
        return equimesh_schema.Certificate(
            status=str(self.status),
            mode=None if self.mode is None else str(self.mode),
            equation_residual=finite_or_none(self.equation_residual),
            discretization_error=_or_nan(self.discretization_error),
            algebraic_error=_or_nan(self.algebraic_error),
            min_jacobian=self.min_jacobian,
            angles=equimesh_schema.FaceAngles(max=faces.non_orthogonality, mean=faces.mean_non_orthogonality),
            skewness=faces.skewness,
            relaxed=self.relaxed,
            warnings=self.warnings,
            resolved=self.resolved,
            interpolation_gain=None
            if gain is None
            else equimesh_schema.InterpolationGain(l2=gain.gain_l2, h1=gain.gain_h1),
            target=self.target,
            comparison=self.comparison,
            estimate=self.estimate,
            compared_with=self.compared_with,
            understood=self.understood,
        )

    def summary(self) -> dict[str, Any]:
        """The certificate as plain Python data, ready for JSON; a number that is not known or finite is ``None``."""
        return self.document.to_json()

    @property
    def headline(self) -> str:
        """What the mesh is worth, in one sentence."""
        return self.document.headline

    def __str__(self) -> str:
        """The certificate in a few lines: the headline first, the warnings last."""
        return str(self.document)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
