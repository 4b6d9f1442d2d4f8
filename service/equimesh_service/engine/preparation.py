"""The preparation of a worker process: a log like that of the service, and a tracer where traces are requested."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh_service.settings import Settings
from equimesh_service.telemetry import logs, tracing
from equimesh_service.telemetry.tracer import open_tracer


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """A picklable record of the preparation; calling it prepares the process."""

    log_level: str
    log_format: str
    trace_endpoint: str

    @classmethod
    def of(cls, settings: Settings) -> Preparation:
        """The preparation that the settings require."""
        return cls(log_level=settings.log_level, log_format=settings.log_format, trace_endpoint=settings.trace_endpoint)

    def __call__(self) -> None:
        """Prepare this process."""
        logs.configure(self.log_level, self.log_format)
        tracing.use(open_tracer(self.trace_endpoint, "worker"))
