"""The work of the client, as generators without I/O that a session drives.

A flow yields steps and is sent their outcomes: a :class:`Send` is answered with a :class:`Reply` or a
:class:`FailedConnection`, a :class:`Pause` and a :class:`Report` with None. What a flow returns is its result.
Retries, waiting and deadlines are written here once, for :class:`Client` and :class:`AsyncClient`.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from equimesh_client.errors import (
    BadArgument,
    Conflict,
    DeadlineExceeded,
    DownloadDamaged,
    EquimeshClientError,
    NotFound,
    ProblemError,
    RateLimited,
    ServerError,
    ServiceUnreachable,
)
from equimesh_client.records.resources import FINISHED
from equimesh_client.spec.domains import Domain, box_around, domain_json
from equimesh_client.spec.request import UPLOAD, GenerateArguments, MeshRequest
from equimesh_client.spec.sources import needs_box, read_mesh_file, upload_of
from equimesh_client.wire import protocol
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.downloads import Download, PartFile
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.settings import RETRIED, Deadline, Settings, pause_before_retry, retry_after_of
from equimesh_client.wire.stream import StreamPosition
from equimesh_coupling.samples import UNIT_BOX, Box
from equimesh_schema import Certificate
from equimesh_schema.domains import MeshFile

T = TypeVar("T")
LONG_POLL_SECONDS = 20
"""How long the service may hold an answer back when no progress bar is shown."""
MAX_CANCEL_SECONDS = 2.0
"""Time to cancel a mesh whose caller has stopped waiting."""
MIN_HELD_SECONDS = 0.5
"""An answer that comes sooner was not held back; the next request is then delayed."""
MIN_STREAM_SECONDS = 5.0
"""An event stream that was open for longer counts as working, even without an event."""


@dataclass(frozen=True, kw_only=True)
class Send:
    """Send this call, within ``deadline``, with at most ``timeout`` seconds between two bytes of the answer.

    A ``sink`` takes the body of a success.
    """

    call: Call
    timeout: float
    deadline: Deadline
    sink: Download | None = None


@dataclass(frozen=True, kw_only=True)
class Pause:
    """Sleep."""

    seconds: float


@dataclass(frozen=True, kw_only=True)
class Report:
    """The current resource of the mesh that the caller waits for."""

    record: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class FailedConnection:
    """The outcome of a :class:`Send` without an answer."""

    reason: str


Step: TypeAlias = Send | Pause | Report
Outcome: TypeAlias = Reply | FailedConnection | None
Flow: TypeAlias = Generator[Step, Outcome, T]
GivenDomain: TypeAlias = Domain | Mapping[str, Any] | None
"""A domain, its JSON, or None for the unit square."""


def persist(call: Call, settings: Settings, deadline: Deadline, sink: Download | None = None) -> Flow[Reply]:
    """The first answer that is not retried, success or not; raises when there is none before the deadline.

    Each attempt at a download requests the bytes that the ``sink`` lacks. An attempt that received more bytes than all
    before it starts the count of failures again.
    """
    attempt, furthest = 0, 0
    while True:
        if deadline.left <= 0:
            raise deadline.exceeded(f"{call.method} {call.path}")
        timeout = min(settings.timeout + call.patience, deadline.left)
        attempted = call if sink is None else replace(call, headers={**call.headers, **sink.headers})
        outcome = yield Send(call=attempted, timeout=timeout, deadline=deadline, sink=sink)
        assert outcome is not None
        if sink is not None and isinstance(outcome, FailedConnection):
            if sink.whole:
                return Reply(status=200, headers={})  # the connection broke after the last byte
            if sink.received > furthest:
                attempt, furthest = 0, sink.received
        if isinstance(outcome, Reply):
            status: int | None = outcome.status
            after = retry_after_of(outcome.headers)
        else:
            status = after = None
        pause = None
        if status is None or status >= 400:
            pause = pause_before_retry(settings.policy, attempt, status=status, retry_after=after)
        if deadline.left <= (pause or 0.0) and (isinstance(outcome, FailedConnection) or pause is not None):
            error = deadline.exceeded(f"{call.method} {call.path}")
            last = outcome.reason if isinstance(outcome, FailedConnection) else f"the last answer was HTTP {status}"
            raise DeadlineExceeded(f"{error}; {last}")
        if pause is None:
            if isinstance(outcome, FailedConnection):
                raise unreachable(settings.url, outcome.reason)
            return outcome
        yield Pause(seconds=pause)
        attempt += 1


def unreachable(url: str, reason: str) -> ServiceUnreachable:
    """The exception for a service that does not answer, with the remedy."""
    advice = "start one with `equimesh serve`, or give its URL"
    if "[SSL" in reason and "CERTIFICATE" not in reason:
        advice = "give http:// if the service has no TLS"
    return ServiceUnreachable(f"no equimesh service answers at {url} ({reason}); {advice}")


def request(call: Call, settings: Settings, deadline: Deadline | None = None) -> Flow[Reply]:
    """A successful answer; raises the problem of any other."""
    reply = yield from persist(call, settings, deadline or settings.deadline())
    return protocol.raise_for_status(reply, call)


def fetch(call: Call, settings: Settings, deadline: Deadline | None = None) -> Flow[dict[str, Any]]:
    """The JSON object of the answer to a call."""
    return protocol.json_of((yield from request(call, settings, deadline)))


def prepare(arguments: GenerateArguments, settings: Settings, deadline: Deadline) -> Flow[MeshRequest]:
    """The request for the mesh of `generate`.

    One file of samples is sent with the request, and so is a mesh file that is the domain. Several files of samples are
    stored at the service first, equal ones once; so is one of which a column was chosen, and the mesh file, where its
    box is needed.
    """
    given, box, mesh = arguments.options["domain"], arguments.box(), None
    if isinstance(given, MeshFile) and isinstance(given.file, Path) and box is not None:
        mesh = read_mesh_file(given.file)
        arguments = arguments.on(replace(given, file=UPLOAD))
    else:
        domain = yield from stored_domain(given, settings, deadline)
        arguments = arguments.on(domain)
        if box is None and domain is not None:
            box = yield from box_of(domain, settings, deadline)
    mesh_request = replace(arguments.request(box or UNIT_BOX), mesh=mesh)
    if len(mesh_request.uploads) < 2 and not any(upload.column for upload in mesh_request.uploads):
        return mesh_request
    ids = []
    for upload in mesh_request.uploads:
        reply = yield from request(protocol.upload_samples(upload), settings, deadline)
        ids.append(str(protocol.json_of(reply)["id"]))
    return mesh_request.with_stored_samples(ids)


def stored_domain(domain: GivenDomain, settings: Settings, deadline: Deadline) -> Flow[GivenDomain]:
    """The domain; a mesh file of this machine is stored at the service, and named by its id."""
    if not isinstance(domain, MeshFile):
        return domain
    if not isinstance(domain.file, Path):
        if Path(domain.file).suffix:  # no id has one
            raise BadArgument(f"{domain.file!r} looks like the name of a file: give pathlib.Path({domain.file!r})")
        return domain
    reply = yield from request(protocol.upload_mesh(read_mesh_file(domain.file)), settings, deadline)
    return replace(domain, file=str(protocol.json_of(reply)["id"]))


def box_of(domain: Domain | Mapping[str, Any], settings: Settings, deadline: Deadline) -> Flow[Box]:
    """The box of a domain with curves, from the service, which evaluates them."""
    call = protocol.check_expression("0", None, None, domain_json(domain))
    return protocol.box_of((yield from request(call, settings, deadline)))


def hold_seconds(deadline: Deadline, *, watched: bool = False) -> int:
    """Seconds for which the service may hold an answer back, until the mesh is finished."""
    return max(1, min(1 if watched else LONG_POLL_SECONDS, int(deadline.left)))


def create(mesh_request: MeshRequest, settings: Settings, *, wait: int, deadline: Deadline) -> Flow[dict[str, Any]]:
    """The resource of a new mesh."""
    call = protocol.create_mesh(mesh_request, wait=wait)
    return protocol.mesh_of((yield from request(call, settings, deadline)))


def compute(mesh_request: MeshRequest, settings: Settings, deadline: Deadline) -> Flow[MeshArrays]:
    """The arrays and the certificate of a mesh that the service does not keep."""
    reply = yield from request(protocol.compute_mesh(mesh_request), settings, deadline)
    return replace(arrays_of(reply.body), certificate=protocol.certificate_of(reply))


def compute_file(
    mesh_request: MeshRequest, format: str, settings: Settings, deadline: Deadline
) -> Flow[tuple[bytes, Certificate | None]]:
    """The file of a mesh that the service does not keep, and the certificate."""
    reply = yield from request(protocol.compute_mesh(mesh_request, format), settings, deadline)
    return reply.body, protocol.certificate_of(reply)


def abandon(mesh_request: MeshRequest, mesh_id: str | None, settings: Settings) -> Flow[None]:
    """Cancel an abandoned mesh, best effort; returns nothing.

    ``mesh_id`` is None when no answer has arrived. The request is then repeated: its key returns the same mesh.
    """
    deadline = Deadline.after(MAX_CANCEL_SECONDS)
    try:
        if mesh_id is None:
            mesh_id = str((yield from create(mesh_request, settings, wait=0, deadline=deadline))["id"])
        yield from cancel(mesh_id, settings, deadline)
    except EquimeshClientError:
        return


def wait(record: Mapping[str, Any], settings: Settings, deadline: Deadline, *, watched: bool) -> Flow[dict[str, Any]]:
    """The resource once its status is final. ``watched``: report at least every second."""
    now = dict(record)
    idle = 0.05
    yield Report(record=now)
    while now.get("status") not in FINISHED:
        if deadline.left <= 0:
            raise deadline.exceeded(f"mesh {now['id']} is still {now.get('status', 'unknown')}")
        sent = deadline.clock()
        call = protocol.get_mesh(str(now["id"]), wait=hold_seconds(deadline, watched=watched))
        now = protocol.mesh_of((yield from request(call, settings, deadline)))
        yield Report(record=now)
        if now.get("status") not in FINISHED and deadline.clock() - sent < MIN_HELD_SECONDS:
            # no tight loop of requests
            yield Pause(seconds=min(idle, deadline.left))
            idle = min(1.0, idle * 2.0)
    return now


def cancel(mesh_id: str, settings: Settings, deadline: Deadline | None = None) -> Flow[dict[str, Any]]:
    """The resource after a cancel. A mesh that was canceled before, for instance by a lost request, is no error."""
    call = protocol.cancel_mesh(mesh_id)
    try:
        reply = yield from request(call, settings, deadline)
    except Conflict:
        now = protocol.mesh_of((yield from request(protocol.get_mesh(mesh_id), settings, deadline)))
        if now.get("status") != "canceled":
            raise
        return now
    if not reply.body.strip():
        return protocol.mesh_of((yield from request(protocol.get_mesh(mesh_id), settings, deadline)))
    return protocol.mesh_of(reply)


def delete(call: Call, settings: Settings, deadline: Deadline) -> Flow[None]:
    """Delete a resource; returns nothing. "Not found" is an error only at the first attempt."""
    flow = persist(call, settings, deadline)
    sends, outcome = 0, None
    try:
        while True:
            step = flow.send(outcome)
            sends += isinstance(step, Send)
            outcome = yield step
    except StopIteration as stop:
        reply: Reply = stop.value
    try:
        protocol.raise_for_status(reply, call)
    except NotFound:
        if sends == 1:
            raise


def download(call: Call, settings: Settings, deadline: Deadline, into: Download) -> Flow[None]:
    """Download into ``into``, which is complete afterwards. Bytes that do not match the ETag are fetched once more."""
    for attempt in (1, 2):
        if not into.whole:
            reply = yield from persist(call, settings, deadline, into)
            if reply.status == 416 and attempt == 1:  # the local bytes are no part of this file
                into.restart()
                continue
            protocol.raise_for_status(reply, call)
        try:
            return into.check()
        except DownloadDamaged:
            into.restart()
            if attempt == 2:
                raise


def save(call: Call, settings: Settings, deadline: Deadline, part: PartFile) -> Flow[None]:
    """Download a file and give it its name.

    After a lost connection or an expired deadline the part stays next to it; another call continues from there.
    """
    try:
        yield from download(call, settings, deadline, part)
    except (DownloadDamaged, ProblemError) as error:
        if not isinstance(error, ServerError | RateLimited):
            part.discard()
        raise
    part.commit()


def fetch_file(call: Call, settings: Settings, deadline: Deadline) -> Flow[bytes]:
    """The bytes of a file, checked against its ETag."""
    into = Download()
    yield from download(call, settings, deadline, into)
    return into.body()


def upload(
    u: object, n_samples: int, domain: Domain | Mapping[str, Any] | None, settings: Settings, deadline: Deadline
) -> Flow[dict[str, Any]]:
    """The record of stored samples. A callable or an array is sampled on the box of ``domain``."""
    box: Box | None = UNIT_BOX
    if domain is not None and needs_box(u):
        box = box_around(domain)
        if box is None:
            box = yield from box_of(domain, settings, deadline)
    call = protocol.upload_samples(upload_of(u, n_samples=n_samples, box=box or UNIT_BOX))
    return (yield from fetch(call, settings, deadline))


def silence_seconds(settings: Settings, deadline: Deadline) -> float:
    """Seconds that an event stream may be silent; raises when none are left."""
    if deadline.left <= 0:
        raise deadline.exceeded("waiting for events")
    return min(settings.timeout, deadline.left)


def is_stream(head: Reply, call: Call, position: StreamPosition) -> bool:
    """Whether an answer is the event stream.

    False without events after ``position`` (204), and for an answer that is retried; raises for any other.
    """
    if head.status in RETRIED:
        return False
    protocol.raise_for_status(head, call)
    if head.status == 204:
        position.done = True
        return False
    if "text/event-stream" not in head.headers.get("content-type", ""):
        raise ServiceUnreachable(f"{call.path} is no event stream; check that the URL is that of an equimesh service")
    return True


def reconnect_pause(
    position: StreamPosition,
    call: Call,
    settings: Settings,
    deadline: Deadline,
    *,
    ending: Reply | FailedConnection,
    lived: float,
) -> float:
    """Seconds until an event stream with this ``ending`` is opened again; raises when there is no further attempt.

    A connection that was open for more than ``MIN_STREAM_SECONDS``, or brought an event, starts the count of failures
    again. ``lived`` is its time in seconds.
    """
    refused = isinstance(ending, Reply) and ending.status in RETRIED
    if lived > MIN_STREAM_SECONDS and not refused:
        position.failures = 0
    status = ending.status if isinstance(ending, Reply) and refused else None
    after = retry_after_of(ending.headers) if isinstance(ending, Reply) else None
    pause = pause_before_retry(settings.policy, position.failures, status=status, retry_after=after)
    if deadline.left <= (pause or 0.0):
        raise deadline.exceeded("waiting for events")
    if pause is None:
        if isinstance(ending, Reply):
            protocol.raise_for_status(ending, call)
        reason = ending.reason if isinstance(ending, FailedConnection) else "closed by the service"
        raise unreachable(settings.url, f"the event stream ended early, {reason}")
    position.failures += 1
    return max(pause, min(position.retry, deadline.left))
