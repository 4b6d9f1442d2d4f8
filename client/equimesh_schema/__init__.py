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
from equimesh_schema.domains import AnnulusSector, MeshFile, Quadrilateral, Rectangle
from equimesh_schema.mesh import Target
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
from equimesh_schema.schwarz import BlockSchwarz, Classical, LinearRobin, NonlinearRobin, Optimized, Schwarz

__all__ = [
    "Aim",
    "AnnulusSector",
    "ArcLength",
    "Auto",
    "BlockSchwarz",
    "Candidate",
    "Certificate",
    "Classical",
    "Curvature",
    "Estimate",
    "FaceAngles",
    "InterpolationGain",
    "Intersection",
    "LeastError",
    "LinearRobin",
    "MeshFile",
    "NodalSolution",
    "NonlinearRobin",
    "Optimized",
    "Quadrilateral",
    "Rectangle",
    "Relaxed",
    "Schwarz",
    "Target",
    "Tensor",
    "Weight",
]
