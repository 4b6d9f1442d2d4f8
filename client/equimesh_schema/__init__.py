"""What is requested and what is answered, described once for solver, service, client and command line."""

from typing import NoReturn

from equimesh_schema import monitors
from equimesh_schema.certificate import (
    Aim,
    Candidate,
    Certificate,
    DegreeGain,
    ErrorProducts,
    Estimate,
    FaceAngles,
    InterpolationGain,
    Relaxed,
    SolverGain,
)
from equimesh_schema.domains import AnnulusSector, FixedRectangle, MeshFile, Quadrilateral, Rectangle
from equimesh_schema.mesh import Target
from equimesh_schema.monitors import *  # noqa: F403
from equimesh_schema.schwarz import Classical, LinearRobin, NonlinearRobin, Optimized, Schwarz

__all__ = [
    "Aim",
    "AnnulusSector",
    "Candidate",
    "Certificate",
    "Classical",
    "DegreeGain",
    "ErrorProducts",
    "Estimate",
    "FaceAngles",
    "FixedRectangle",
    "InterpolationGain",
    "LinearRobin",
    "MeshFile",
    "NonlinearRobin",
    "Optimized",
    "Quadrilateral",
    "Rectangle",
    "Relaxed",
    "Schwarz",
    "SolverGain",
    "Target",
]
__all__ += monitors.__all__


def __getattr__(name: str) -> NoReturn:
    if name == "BlockSchwarz":
        raise AttributeError("equimesh_schema.BlockSchwarz is equimesh_schema.Schwarz now, of grids and of blocks")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
