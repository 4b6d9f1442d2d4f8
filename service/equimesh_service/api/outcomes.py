"""The models of what a finished mesh says of itself besides its certificate: convergence and timings."""

from pydantic import BaseModel, Field


class ConvergenceSummary(BaseModel):
    """How the solve went, in one line."""

    status: str = Field(description="converged, completed, relaxed, not_converged, newton_failed, folded.")
    message: str
    iterations: int = Field(description="Schwarz iterations; 0 for a single domain.")
    newton_steps: int = Field(description="In all.")
    transmission: str | None = Field(
        None, description="The Schwarz condition in use at the end; after a fallback, not the requested one."
    )
    work: int | None = Field(None, description="Nodes corrected in all Schwarz iterations, counted each time.")
    traffic: int | None = Field(None, description="Bytes that subdomains on machines of their own would have sent.")
    residual: float | None = Field(description="Of the equations, relative.")
    change: float | None = Field(description="Largest move of a node in the last iteration.")
    error: float | None
    max_q_eq: float | None = Field(description="Largest share of the metric of a cell; 1 where all are equal.")
    rate: float | None
    predicted_rate: float | None


class Timings(BaseModel):
    """The time of each part, in seconds."""

    queued: float | None = None
    solve: float | None = None
    write: float | None = None
    total: float | None = Field(None, description="From the request to the end.")
