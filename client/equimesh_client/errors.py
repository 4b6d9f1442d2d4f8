"""The exceptions of the client: one tree, drawn here.

::

    EquimeshClientError      the root of all packages, EquimeshError of equimesh_coupling, under its name here
    ├── CouplingError        a mesh does not reach another library, or values do not come back; drawn there
    ├── BadArgument          refused before anything was sent (also a ValueError)
    ├── ServiceUnreachable   no service answers at this address (also a ConnectionError)
    ├── DeadlineExceeded     the deadline of the caller has passed (also a TimeoutError)
    ├── DownloadDamaged      a file that does not have the checksum the service announced
    ├── ProblemError         the service answered with an error: status, type, title, detail, errors
    │   ├── InvalidInput     422: a fault in the request; says where
    │   ├── Unauthorized     401: the service needs a key that it knows
    │   ├── Forbidden        403: the key does not allow this, or the service without keys does not know the host
    │   ├── NotFound         404: no such mesh, file or samples
    │   │   └── Gone         410: expired and removed
    │   ├── Conflict         409: not in the state that this request needs
    │   ├── TooLarge         413: over a limit of the service
    │   ├── RateLimited      429: too many requests, also after retries
    │   │   └── QuotaExceeded  a limit of the key is reached
    │   └── ServerError      500 and above
    │       └── StorageFull  507: the storage of the service is full
    ├── MeshFailed           the mesh was computed and failed; carries mesh and problem
    └── MeshCanceled         the mesh was canceled; carries mesh
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from equimesh_client.records.resources import MeshState
from equimesh_coupling.errors import EquimeshError

# One root for all packages: it also catches what a mesh raises on its way to another library.
EquimeshClientError = EquimeshError


class BadArgument(EquimeshClientError, ValueError):
    """An argument that cannot be used; nothing was sent."""


class ServiceUnreachable(EquimeshClientError, ConnectionError):
    """No equimesh service answers at the address, after all retries."""


class DeadlineExceeded(EquimeshClientError, TimeoutError):
    """The caller's deadline has passed. ``mesh`` is the mesh that was waited for, if there is one."""

    def __init__(self, message: str, *, mesh: MeshState | None = None) -> None:
        super().__init__(message)
        self.mesh = mesh


class DownloadDamaged(EquimeshClientError):
    """A downloaded file does not have the sha256 that the service announced; nothing was written."""


@dataclass(frozen=True, kw_only=True)
class InputProblem:
    """One fault of a request: a JSON ``pointer`` into it and a ``message``.

    Inside an expression also its ``text``, and the ``line`` and ``column`` of the fault, which count from 1. For a file
    of samples also its ``columns``, where one of them has to be chosen as u, by :class:`SampleFile`.
    """

    pointer: str
    message: str
    line: int | None = None
    column: int | None = None
    text: str | None = None
    columns: tuple[str, ...] = ()

    def __str__(self) -> str:
        head = f"{self.pointer}: {self.message}" if self.pointer else self.message
        shown = caret(self.text, line=self.line, column=self.column)
        return f"{head}\n{shown}" if shown else head


def caret(text: str | None, *, line: int | None, column: int | None) -> str:
    """The line of ``text``, indented, with a caret under ``column`` (from 1); empty without such a place."""
    if text is None or column is None:
        return ""
    lines = text.splitlines() or [""]
    number = (1 if line is None else line) - 1
    if not 0 <= number < len(lines) or column < 1:
        return ""
    shown = lines[number]
    before = "".join("\t" if sign == "\t" else " " for sign in shown[: column - 1]).ljust(column - 1)
    return f"    {shown}\n    {before}^"


class ProblemError(EquimeshClientError):
    """The service answered with a problem (RFC 9457).

    ``status`` is the HTTP status, ``type`` the stable name of the problem. ``title`` and ``detail`` describe it,
    ``errors`` lists the faults of the input. ``problem`` is the whole document. ``retry_after`` is the time in seconds
    after which the service allows another attempt. ``advice`` is the remedy for users of the client, where it differs
    from that of the service.
    """

    advice: ClassVar[str] = ""

    def __init__(
        self,
        *,
        status: int,
        type: str = "about:blank",
        title: str = "",
        detail: str = "",
        errors: Sequence[InputProblem] = (),
        problem: Mapping[str, Any] | None = None,
        retry_after: float | None = None,
    ) -> None:
        super().__init__(title, detail)
        self.status = status
        self.type = type
        self.title = title
        self.detail = detail
        self.errors = tuple(errors)
        self.problem = dict(problem or {})
        self.retry_after = retry_after

    def __str__(self) -> str:
        detail = "" if self.errors else self.detail  # with errors, the detail only repeats the first
        words = ": ".join(part.rstrip(".") for part in (self.title, detail) if part)
        lines = [f"{words or 'the service answered with an error'} (HTTP {self.status})"]
        for error in self.errors:
            lines += ["  " + line for line in str(error).splitlines()]
        remedy = self.advice or str(self.problem.get("remedy") or "")
        if not self.errors and remedy:
            lines.append(remedy)
        if self.retry_after:
            lines.append(f"Try again in {self.retry_after:g} s.")
        return "\n".join(lines)


class InvalidInput(ProblemError, ValueError):
    """422: something in the request cannot be used; ``errors`` names each fault and its place."""


class Unauthorized(ProblemError):
    """401: the request has no key that the service knows."""

    advice = (
        "Give a key that the service knows: key=... in Python, --key or the environment variable EQUIMESH_KEY; "
        "the operator of the service creates one with `equimesh keys create`."
    )


class Forbidden(ProblemError):
    """403: the key does not allow this, or a service without keys does not know the host. The detail says which."""

    advice = "Use a key that has this scope; the operator of the service creates one with `equimesh keys create`."


class NotFound(ProblemError, LookupError):
    """404: there is no such mesh, file or samples. :class:`Gone` is for those that have expired."""


class Gone(NotFound):
    """410: the mesh has expired and was removed."""

    advice = "Request the mesh again: the same request computes it anew."


class Conflict(ProblemError):
    """409: the mesh is not in the state that the request needs."""


class TooLarge(ProblemError):
    """413: over a limit of the service; see ``client.capabilities()``."""


class RateLimited(ProblemError):
    """429: too many requests; ``retry_after`` is the time to wait, in seconds."""


class QuotaExceeded(RateLimited):
    """429: more unfinished meshes, points or stored bytes than one key may have; the detail says which."""

    advice = "Wait until meshes of this key are finished, cancel some, or delete what is no longer needed."


class ServerError(ProblemError):
    """500 and above: the service failed, not the request."""


class StorageFull(ServerError):
    """507: the storage of the service is full. Not retried: waiting does not free storage."""

    advice = "Nothing is wrong with the request: delete meshes that are no longer needed, or tell the operator."


class MeshFailed(EquimeshClientError):
    """A mesh that ended as ``failed``: ``mesh``, and the ``problem`` document of the service."""

    def __init__(self, mesh: MeshState, problem: Mapping[str, Any]) -> None:
        super().__init__(mesh.id)
        self.mesh = mesh
        self.problem = dict(problem)

    def __str__(self) -> str:
        # The remedy of faults of the input points to their list, of which the detail has the first.
        keys = ("title", "detail") if self.problem.get("errors") else ("title", "detail", "remedy")
        sentences = [str(self.problem[key]) for key in keys if self.problem.get(key)]
        words = ". ".join(sentence.rstrip(".") for sentence in dict.fromkeys(sentences))
        return f"mesh {self.mesh.id} failed: {words or 'no reason given'}"


class MeshCanceled(EquimeshClientError):
    """A mesh that was canceled before it was finished."""

    def __init__(self, mesh: MeshState) -> None:
        super().__init__(f"mesh {mesh.id} was canceled")
        self.mesh = mesh


BY_STATUS: Mapping[int, type[ProblemError]] = {
    401: Unauthorized,
    403: Forbidden,
    404: NotFound,
    409: Conflict,
    410: Gone,
    413: TooLarge,
    422: InvalidInput,
    429: RateLimited,
    507: StorageFull,
}
BY_TYPE: Mapping[str, type[ProblemError]] = {"/problems/quota-exceeded": QuotaExceeded}


def error_class(status: int, type: str = "") -> type[ProblemError]:
    """The exception for an HTTP status and the type of a problem; the type decides where a status has several."""
    return BY_TYPE.get(type) or BY_STATUS.get(status, ServerError if status >= 500 else ProblemError)
