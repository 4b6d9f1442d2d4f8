"""What the client does, step by step, without I/O: generators that both shells drive.

A flow yields steps and is sent their outcomes: a :class:`Send` is answered with a :class:`Reply` or a
:class:`Disconnected`, a :class:`Pause` and a :class:`Report` with None. What a flow returns is its result.
Retries, waiting and deadlines live here, once, for :class:`Client` and :class:`AsyncClient`.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

from equimesh_client.errors import (
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
from equimesh_client.records.state import FINISHED
from equimesh_client.spec.domains import UNIT_BOX, Box, Domain, domain_json, read_domain
from equimesh_client.spec.request import Order, Wish
from equimesh_client.spec.sources import needs_box, upload_of
from equimesh_client.wire import protocol
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.downloads import Download, PartFile
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.retry import RETRIED, pause_before_retry, retry_after_of
from equimesh_client.wire.stream import StreamPosition

T = TypeVar("T")
LONG_POLL = 20
"""Seconds that the service is asked to hold an answer back while nobody watches the progress."""
FAREWELL = 2.0
"""Seconds for canceling a mesh that nobody waits for any more."""


@dataclass(frozen=True, kw_only=True)
class Send:
    """Send this call; nothing may arrive for at most ``timeout`` seconds, all within the ``deadline``. A
    ``sink`` takes the body of a success.
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
    """News of the mesh that is waited for: the resource as it is now."""

    record: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Disconnected:
    """The outcome of a :class:`Send` that brought no answer."""

    reason: str


Step: TypeAlias = Send | Pause | Report
Outcome: TypeAlias = Reply | Disconnected | None
Flow: TypeAlias = Generator[Step, Outcome, T]


def persist(call: Call, settings: Settings, deadline: Deadline, sink: Download | None = None) -> Flow[Reply]:
    """The first answer that is not worth a retry, success or not; raises when there is none in time.

    Each attempt at a download asks for what is missing in the ``sink``. One that got further than all before it was a
    good one: only failures in a row count.
    """
    attempt, furthest = 0, 0
    while True:
        if deadline.left <= 0:
            raise deadline.exceeded(f"{call.method} {call.path}")
        timeout = min(settings.timeout + call.patience, deadline.left)
        asked = call if sink is None else replace(call, headers={**call.headers, **sink.headers})
        outcome = yield Send(call=asked, timeout=timeout, deadline=deadline, sink=sink)
        assert outcome is not None
        if sink is not None and isinstance(outcome, Disconnected):
            if sink.whole:
                return Reply(status=200, headers={})  # the line broke after the last byte
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
        if deadline.left <= (pause or 0.0) and (isinstance(outcome, Disconnected) or pause is not None):
            error = deadline.exceeded(f"{call.method} {call.path}")
            last = outcome.reason if isinstance(outcome, Disconnected) else f"the last answer was HTTP {status}"
            raise DeadlineExceeded(f"{error}; {last}")
        if pause is None:
            if isinstance(outcome, Disconnected):
                raise unreachable(settings.url, outcome.reason)
            return outcome
        yield Pause(seconds=pause)
        attempt += 1


def unreachable(url: str, reason: str) -> ServiceUnreachable:
    """The exception for a service that does not answer, with what to do about it."""
    return ServiceUnreachable(
        f"no equimesh service answers at {url} ({reason}); start one with `equimesh serve`, or give its URL"
    )


def request(call: Call, settings: Settings, deadline: Deadline | None = None) -> Flow[Reply]:
    """A successful answer; raises the problem when it is none."""
    reply = yield from persist(call, settings, deadline or settings.deadline())
    return protocol.checked(reply, call)


def fetch(call: Call, settings: Settings, deadline: Deadline | None = None) -> Flow[dict[str, Any]]:
    """The JSON object that a call is answered with."""
    return protocol.json_of((yield from request(call, settings, deadline)))


def prepared(wish: Wish, settings: Settings, deadline: Deadline) -> Flow[Order]:
    """The request for the mesh of `generate`. One file of samples goes with it; several are stored at the service
    first, which keeps each of them once however often it is sent.
    """
    box = wish.box()
    if box is None and wish.domain is not None:
        box = yield from box_of(wish.domain, settings, deadline)
    made = wish.order(box or UNIT_BOX)
    if len(made.uploads) < 2:
        return made
    names = []
    for upload in made.uploads:
        reply = yield from request(protocol.upload_samples(upload), settings, deadline)
        names.append(str(protocol.json_of(reply)["id"]))
    return made.stored(names)


def box_of(domain: Domain | Mapping[str, Any], settings: Settings, deadline: Deadline) -> Flow[Box]:
    """The box of a domain whose curves only the service evaluates."""
    call = protocol.check_expression("0", None, None, domain_json(domain))
    return protocol.box_of((yield from request(call, settings, deadline)))


def create(made: Order, settings: Settings, *, wait: int, deadline: Deadline) -> Flow[dict[str, Any]]:
    """The resource of a new mesh."""
    upload = made.uploads[0] if made.uploads else None
    call = protocol.create_mesh(made.spec, upload, wait=wait, key=made.key, reuse=made.reuse)
    return protocol.mesh_of((yield from request(call, settings, deadline)))


def abandon(made: Order, mesh_id: str | None, settings: Settings) -> Flow[None]:
    """Nothing. Cancels, as well as can be done in a short time, a mesh that nobody waits for any more.

    When its id is not known, because the answer to the request has not arrived, the same key tells it.
    """
    deadline = Deadline.after(FAREWELL)
    try:
        if mesh_id is None:
            mesh_id = str((yield from create(made, settings, wait=0, deadline=deadline))["id"])
        yield from cancel(mesh_id, settings, deadline)
    except EquimeshClientError:
        return


def wait(record: Mapping[str, Any], settings: Settings, deadline: Deadline, *, watched: bool) -> Flow[dict[str, Any]]:
    """The resource once its status is final. ``watched``: report at least every second."""
    now = dict(record)
    hold, idle = (1 if watched else LONG_POLL), 0.05
    yield Report(record=now)
    while now.get("status") not in FINISHED:
        if deadline.left <= 0:
            raise deadline.exceeded(f"mesh {now['id']} is still {now.get('status', 'unknown')}")
        asked = deadline.clock()
        call = protocol.get_mesh(str(now["id"]), wait=max(1, min(hold, int(deadline.left))))
        now = protocol.mesh_of((yield from request(call, settings, deadline)))
        yield Report(record=now)
        if now.get("status") not in FINISHED and deadline.clock() - asked < 0.5:
            # The service did not hold the answer back: do not ask in a tight loop.
            yield Pause(seconds=min(idle, deadline.left))
            idle = min(1.0, idle * 2.0)
    return now


def cancel(mesh_id: str, settings: Settings, deadline: Deadline | None = None) -> Flow[dict[str, Any]]:
    """The resource after a cancel. That it was canceled before, perhaps by a request whose answer got lost,
    is fine.
    """
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
    """Nothing. That it is gone already is an error only when no earlier attempt can have removed it."""
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
        protocol.checked(reply, call)
    except NotFound:
        if sends == 1:
            raise


def download(call: Call, settings: Settings, deadline: Deadline, into: Download) -> Flow[None]:
    """Nothing; ``into`` is whole afterwards. Bytes that do not match the ETag are fetched a second time."""
    for attempt in (1, 2):
        if not into.whole:
            reply = yield from persist(call, settings, deadline, into)
            if reply.status == 416 and attempt == 1:  # what is there is no part of this file
                into.restart()
                continue
            protocol.checked(reply, call)
        try:
            return into.check()
        except DownloadDamaged:
            into.restart()
            if attempt == 2:
                raise


def save(call: Call, settings: Settings, deadline: Deadline, part: PartFile) -> Flow[None]:
    """Nothing; the file has its name afterwards. What has arrived when the line or the time ends stays beside it, for
    another call to go on with.
    """
    try:
        yield from download(call, settings, deadline, part)
    except (DownloadDamaged, ProblemError) as error:
        if not isinstance(error, ServerError | RateLimited):
            part.discard()
        raise
    part.commit()


def verified(call: Call, settings: Settings, deadline: Deadline) -> Flow[bytes]:
    """The body of a file, checked against its ETag."""
    into = Download()
    yield from download(call, settings, deadline, into)
    return into.body()


def upload(
    u: object, n_samples: int, domain: Domain | Mapping[str, Any] | None, settings: Settings, deadline: Deadline
) -> Flow[dict[str, Any]]:
    """The record of samples that are stored, sampled on the box of ``domain`` where they are a callable or an array."""
    box: Box | None = UNIT_BOX
    if domain is not None and needs_box(u):
        known = read_domain(domain) if isinstance(domain, Mapping) else domain
        box = known.box
        if box is None:
            box = yield from box_of(domain, settings, deadline)
    call = protocol.upload_samples(upload_of(u, n_samples=n_samples, box=box or UNIT_BOX))
    return (yield from fetch(call, settings, deadline))


def pages(
    settings: Settings, deadline: Deadline, *, status: str | None, label: str | None, cursor: str | None, limit: int
) -> Flow[tuple[list[dict[str, Any]], str | None]]:
    """One page of meshes and the cursor of the next."""
    call = protocol.list_meshes(status=status, label=label, limit=limit, cursor=cursor)
    answer = yield from fetch(call, settings, deadline)
    return list(answer.get("items") or []), answer.get("next_cursor")


def silence(settings: Settings, deadline: Deadline) -> float:
    """Seconds that an event stream may be silent; raises when none are left."""
    if deadline.left <= 0:
        raise deadline.exceeded("waiting for events")
    return min(settings.timeout, deadline.left)


def streams(head: Reply, call: Call, position: StreamPosition) -> bool:
    """Whether an answer is the event stream. False when there is nothing after ``position`` (204), and when it is
    worth a retry; raises when it is neither.
    """
    if head.status in RETRIED:
        return False
    protocol.checked(head, call)
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
    ending: Reply | Disconnected,
    lived: float,
) -> float:
    """Seconds until an event stream that had this ``ending`` is opened again; raises when that is pointless or too
    late.

    A connection that ``lived`` some seconds, or brought an event, was a good one: only failures in a row
    count.
    """
    refused = isinstance(ending, Reply) and ending.status in RETRIED
    if lived > 5.0 and not refused:
        position.failures = 0
    status = ending.status if isinstance(ending, Reply) and refused else None
    after = retry_after_of(ending.headers) if isinstance(ending, Reply) else None
    pause = pause_before_retry(settings.policy, position.failures, status=status, retry_after=after)
    if deadline.left <= (pause or 0.0):
        raise deadline.exceeded("waiting for events")
    if pause is None:
        if isinstance(ending, Reply):
            protocol.checked(ending, call)
        reason = ending.reason if isinstance(ending, Disconnected) else "closed by the service"
        raise unreachable(settings.url, f"the event stream ended early, {reason}")
    position.failures += 1
    return max(pause, min(position.retry, deadline.left))
