"""Event streams over connections that break, for both clients."""

from __future__ import annotations

import time
from typing import Any

import pytest

from equimesh_client import DeadlineExceeded, NotFound, RateLimited, RetryPolicy, ServiceUnreachable


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_events_come_once_each_over_dropped_connections(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [100, 130, 40]
    events = list(mesh.events(deadline=10))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [event.kind for event in events] == [kind for kind, _ in service.events]
    assert [event.data for event in events] == [data for _, data in service.events]
    requested = [request.headers.get("last-event-id") for request in service.seen("GET", "events")]
    assert requested[0] is None
    assert len(requested) == 4


@pytest.mark.parametrize("cut", range(0, 420, 29))
def test_events_survive_a_cut_anywhere(connect: Any, service: Any, cut: int) -> None:
    mesh = connect(service.url).meshes.create(spec())
    service.cuts = [cut]
    events = list(mesh.events(deadline=10))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [(event.kind, event.data) for event in events] == service.events


def test_events_start_where_asked(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert [event.id for event in mesh.events(after=3)] == [4, 5]
    assert list(mesh.events(after=5)) == []


def test_events_that_never_come_are_given_up(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(ServiceUnreachable, match="event stream"):
        list(mesh.events(deadline=10))


def test_events_have_a_deadline(connect: Any, service: Any) -> None:
    mesh = connect(service.url, retries=RetryPolicy(retries=99, first=0.1)).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=0.5))


def test_events_of_no_mesh(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=404), fault("events", "status", status=503)]
    with pytest.raises(NotFound):
        list(mesh.events())
    assert len(list(mesh.events())) == 5


def test_events_come_back_when_the_service_says_so(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=503, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert len(list(mesh.events(deadline=10))) == 5
    assert time.monotonic() - start > 0.95
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited):
        list(mesh.events(deadline=9999))
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "30"})]
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=10))
