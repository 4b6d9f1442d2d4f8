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

__all__ = ["Aim", "Candidate", "Certificate", "Estimate", "FaceAngles", "InterpolationGain", "Relaxed"]
