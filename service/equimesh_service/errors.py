"""The exceptions of the service: one tree, drawn here.

::

    ServiceError
    ├── CannotServeError            the service cannot start; says why and what to do
    │   ├── ExposedError            other machines would reach it without an API key
    │   ├── FolderInUseError        another service uses the data folder
    │   ├── NotStartedError         its parts cannot start; also a RuntimeError
    │   ├── TracingMissingError     traces are requested and OpenTelemetry is not installed
    │   ├── FilesError              the storage of files cannot be used, now or later; also an OSError
    │   ├── ClusterMissingError     the engine dask is requested and Dask is not installed
    │   └── UnusableDatabaseError   the service cannot work with the database
    │       └── NewerDatabaseError  ... because a newer release has changed it
    ├── RejectedError               the store does not accept a mesh
    │   ├── SamplesGoneError        ... its samples are not there
    │   ├── KeyReusedError          ... its idempotency key belongs to another request
    │   ├── StepTakenError          ... the sequence has taken another step, or the start of the step is gone
    │   └── QuotaError              ... its API key has reached a limit
    ├── EngineError                 a task did not end by itself
    │   ├── TimeLimitError          ... it ran longer than its time limit
    │   ├── MemoryLimitError        ... it needed more memory than its worker may have
    │   ├── WorkerLostError         ... its worker died; running it again may succeed
    │   └── SchedulerLostError      ... the cluster that ran it cannot be reached; running it again will do
    ├── NotCompiledError            a loop is not compiled on this machine yet
    ├── AttemptLostError            the mesh was canceled or is computed elsewhere; the worker stops
    ├── KeyTakenError               a request with the same idempotency key was faster; the worker stops
    └── Problem                     an answer with problem details; it stands in
                                    :mod:`equimesh_service.problems.problem`, next to the table of kinds
"""


class ServiceError(Exception):
    """Base of every exception that the service raises on purpose."""


class CannotServeError(ServiceError):
    """The service cannot start. The message says why and what to do, without secrets."""


class ExposedError(CannotServeError):
    """Other machines would reach the service without an API key, and the settings do not allow that."""


class FolderInUseError(CannotServeError):
    """Another service uses the same data folder."""


class NotStartedError(CannotServeError, RuntimeError):
    """The parts of the service cannot start; the message says why."""


class TracingMissingError(CannotServeError):
    """Traces are requested, and OpenTelemetry is not installed."""


class ClusterMissingError(CannotServeError):
    """The engine dask is requested, and Dask is not installed."""


class FilesError(CannotServeError, OSError):
    """The storage of files cannot be used; the message says which, why, and what to do."""


class UnusableDatabaseError(CannotServeError):
    """The service cannot work with the database; the message does not hold the address."""


class NewerDatabaseError(UnusableDatabaseError):
    """A newer release has changed the database; this release would not understand it."""


class RejectedError(ServiceError):
    """The store does not accept a mesh."""


class SamplesGoneError(RejectedError):
    """The mesh refers to samples that are not there."""


class KeyReusedError(RejectedError):
    """The idempotency key belongs to another request."""


class StepTakenError(RejectedError):
    """The sequence has taken another step meanwhile, or the start of this one is gone."""


class QuotaError(RejectedError):
    """The mesh would take its API key over a limit: the setting, what the key has, and the most it may have."""

    def __init__(self, limit: str, used: int, most: int) -> None:
        super().__init__(f"{limit}: {used} of {most}")
        self.limit, self.used, self.most = limit, used, most


class EngineError(ServiceError):
    """A task that did not end by itself."""


class TimeLimitError(EngineError):
    """The task ran longer than its time limit and was stopped."""


class MemoryLimitError(EngineError):
    """The task needed more memory than its worker may have."""


class WorkerLostError(EngineError):
    """The worker died while it ran the task; running it again may succeed."""


class SchedulerLostError(EngineError):
    """The scheduler of the cluster that ran the task cannot be reached; the task is not to blame."""


class NotCompiledError(ServiceError):
    """A loop is not compiled on this machine yet, where it must not be compiled now."""


class AttemptLostError(ServiceError):
    """The mesh was canceled, or another worker computes it now: no one needs this attempt any more."""


class KeyTakenError(ServiceError):
    """The idempotency key of a request belongs to the mesh ``mesh_id``, whose request was faster."""

    def __init__(self, mesh_id: str) -> None:
        super().__init__(f"the idempotency key belongs to the mesh {mesh_id}")
        self.mesh_id = mesh_id
