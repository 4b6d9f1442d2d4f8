"""What is requested and what is answered, described once for solver, service, client and command line."""

from equimesh_schema.certificate import (
    Aim,
    Candidate,
    Certificate,
    Estimate,
    FaceAngles,
    InterpolationGain,
    Relaxed,
)
from equimesh_schema.monitors import (
    ArcLength,
    Auto,
    Curvature,
    Intersection,
    LeastError,
    NodalSolution,
    Tensor,
    Weight,
)

__all__ = [
    "Aim",
    "ArcLength",
    "Auto",
    "Candidate",
    "Certificate",
    "Curvature",
    "Estimate",
    "FaceAngles",
    "InterpolationGain",
    "Intersection",
    "LeastError",
    "NodalSolution",
    "Relaxed",
    "Tensor",
    "Weight",
]
