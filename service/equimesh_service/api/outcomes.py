"""The models of what a finished mesh says of itself: certificate, convergence and timings."""

from typing import Any, Literal

from pydantic import BaseModel, Field


class ConvergenceSummary(BaseModel):
    """How the solve went, in one line."""

    status: str = Field(description="converged, completed, relaxed, not_converged, newton_failed, folded.")
    message: str
    iterations: int = Field(description="Schwarz iterations; 0 for a single domain.")
    newton_steps: int
    transmission: str | None = Field(
        None, description="The Schwarz condition in use at the end; after a fallback, not the requested one."
    )
    work: int | None = Field(None, description="Nodes corrected in all Schwarz iterations, counted each time.")
    traffic: int | None = Field(None, description="Bytes that subdomains on machines of their own would have sent.")
    residual: float | None
    change: float | None
    error: float | None
    max_q_eq: float | None
    rate: float | None
    predicted_rate: float | None


class Relaxation(BaseModel):
    """An option whose requested value was not reached."""

    what: str = Field(description="a (of the arc length), strength (of other monitors), cross_line, points.")
    asked: float
    reached: float


class InterpolationGain(BaseModel):
    """How many times smaller the interpolation error is than on the uniform mesh, or on the initial one of blocks."""

    l2: float | None
    h1: float | None


class ReachedTarget(BaseModel):
    """A requested interpolation error and what was reached."""

    norm: str
    error: float = Field(description="The requested one.")
    grid: tuple[int, int] = Field(description="The grid that was taken.")
    predicted: float | None = Field(description="The error that was expected on this grid.")
    reached: float | None = Field(description="The measured error.")
    solves: int = Field(description="Grids that were solved to find it.")


class ComparedMonitor(BaseModel):
    """A monitor that auto has tried on a coarse grid."""

    kind: str
    settings: dict[str, Any]
    gain_l2: float | None = Field(description="As interpolation_gain, on the coarse grid; null where it has no mesh.")
    gain_h1: float | None
    chosen: bool = Field(description="Whether it is that of the mesh.")
    gain_cells: float | None = Field(
        None, description="Error at cell centres of a cell-centred code: of the uniform mesh over that of this one."
    )


class FaceAngles(BaseModel):
    """Angles between the normal of an inner face and the line of its two cell centres, as OpenFOAM measures them."""

    max: float | None = Field(None, description="The largest, in degrees; null for a folded mesh.")
    mean: float | None = Field(None, description="The angle whose cosine is the mean of their cosines, in degrees.")


class SolverEstimate(BaseModel):
    """The estimated error of the values that a round of adapting was given, on their own mesh."""

    l2: float = Field(description="In the units of u times a length.")
    h1: float = Field(description="The same for the gradient; it must not rank meshes.")
    unresolved: float = Field(description="h1 over the norm of the gradient: the share that is not resolved.")
    moved_cells: float = Field(
        description="Root mean square of the moves of the nodes in the round, in spacings of the uniform mesh."
    )


class MeshCertificate(BaseModel):
    """How well the mesh solves the requested equations; null stands for unknown."""

    status: str = Field(description="As in convergence; relaxed: for a weaker or smoother monitor than requested.")
    mode: str | None
    equation_residual: float | None = Field(
        description="Largest relative difference of a squared metric length from the mean of its grid line; null for a "
        "mesh that solves no equations."
    )
    discretization_error: float | None = Field(
        description="Estimated error of the nodes that a finer grid would remove, in units of the reference square."
    )
    algebraic_error: float | None = Field(description="Estimated error of the solution of the discrete equations.")
    min_jacobian: float | None = Field(
        description="Smallest corner Jacobian; 1 for the uniform mesh. Of blocks over the mean area of a cell."
    )
    non_orthogonality: FaceAngles | None = Field(None, description="null for a mesh made before it was measured.")
    skewness: float | None = Field(None, description="The largest skewness of a face, as OpenFOAM defines it.")
    relaxed: list[Relaxation]
    warnings: list[str] = Field(description="What a user of the mesh should know.")
    resolved: bool = Field(
        True,
        description="Whether the gains are known; false where a layer of u lies inside a cell: it is null.",
    )
    interpolation_gain: InterpolationGain | None = Field(description="null without a u.")
    target: ReachedTarget | None = Field(None, description="null where the spec has a grid.")
    comparison: list[ComparedMonitor] = Field(
        default_factory=list, description="The monitors among which auto has chosen, the best one first."
    )
    estimate: SolverEstimate | None = Field(None, description="null for a mesh that is no round of adapting.")
    compared_with: Literal["uniform", "initial"] = Field(
        "uniform", description="The mesh that the gains refer to; initial for a domain in blocks."
    )
    understood: dict[str, str] = Field(
        default_factory=dict,
        description="Formulas that were typed in another spelling, as they were understood, by their place.",
    )


class Timings(BaseModel):
    """The time of each part, in seconds."""

    queued: float | None = None
    solve: float | None = None
    write: float | None = None
    total: float | None = None
