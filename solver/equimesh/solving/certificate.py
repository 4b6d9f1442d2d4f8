"""The certificate of a mesh: how well it solves the requested equations, and warnings."""

from dataclasses import dataclass, field

import equimesh_schema
from equimesh.quality.faces import Faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.single_domain.steps import Mode
from equimesh.solving.status import Status
from equimesh_schema.certificate import FaceAngles, InterpolationGain
from equimesh_schema.document import Json

MEASURED = ("faces", "interpolation")
"""The fields that are answered by those that follow from them."""


@dataclass(frozen=True, kw_only=True)
class Certificate(equimesh_schema.Certificate):
    """How well a mesh solves the requested equations, measured on the mesh itself wherever possible.

    The residual is that of the requested equations, also where relaxed ones were solved: 0 on their exact solution. For
    a gradient map it is the root mean square of the relative deviations of the cells' shares from their mean.
    """

    status: Status
    """How the solve ended."""
    mode: Mode | None
    """When a single-domain solve ends; ``None`` for a Schwarz iteration and for a gradient map."""
    faces: Faces
    """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
    discretization_error: float | None = None  # type: ignore[assignment]
    """Estimate of the largest error of a node's coordinate that the grid causes, in units of the reference square.

    ``None`` where it is not known.
    """
    algebraic_error: float | None = None  # type: ignore[assignment]
    """Estimate of the largest error from stopping the iteration, in the same units; ``None`` where it is not known."""
    relaxed: tuple[equimesh_schema.Relaxed, ...] = ()
    """The differences between the requested and the solved equations; empty where there are none."""
    warnings: tuple[str, ...] = ()
    """Sentences to read before using the mesh."""
    interpolation: InterpolationErrors | None = None
    """The errors of interpolating u on the mesh and on the uniform one; ``None`` where there is no u."""
    angles: FaceAngles | None = field(default=None, init=False, repr=False)
    """The angles of ``faces``."""
    skewness: float = field(default=0.0, init=False, repr=False)
    """The skewness of ``faces``."""
    resolved: bool = field(default=True, init=False, repr=False)
    """Whether the gains of interpolation are known: two rules of quadrature agree, or there is no u."""
    interpolation_gain: InterpolationGain | None = field(default=None, init=False, repr=False)
    """The gains of ``interpolation``."""

    def __post_init__(self) -> None:
        faces, errors = self.faces, self.interpolation
        angles = FaceAngles(max=faces.non_orthogonality, mean=faces.mean_non_orthogonality)
        gain = None if errors is None else InterpolationGain(l2=errors.gain_l2, h1=errors.gain_h1)
        resolved = errors is None or all(errors.resolved)
        derived = {"angles": angles, "skewness": faces.skewness, "resolved": resolved, "interpolation_gain": gain}
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def to_json(self) -> Json:
        """The certificate in JSON; a number that is not known or finite is ``None``."""
        return {name: value for name, value in super().to_json().items() if name not in MEASURED}

    def summary(self) -> Json:
        """The certificate as plain Python data, ready for JSON; a number that is not known or finite is ``None``."""
        return self.to_json()
