"""Retries and waiting against a service that misbehaves, for both clients."""

from __future__ import annotations

import socket
import time
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    DeadlineExceeded,
    Forbidden,
    Gone,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
    RetryPolicy,
    ServerError,
    ServiceUnreachable,
    StorageFull,
    Tensor,
    Unauthorized,
)

BIG = np.ones((60, 60))


def test_a_lost_upload_is_sent_again(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/samples", "lose")]
    mesh = connect(service.url).generate(monitor=Tensor(BIG, "0", 2 * BIG), n=8)
    assert (list(service.meshes), len(service.samples)) == ([mesh.id], 2)


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


@pytest.mark.parametrize("action", ["drop", "lose", "status"])
def test_a_create_that_is_repeated_makes_one_mesh(connect: Any, service: Any, fault: Any, action: str) -> None:
    service.faults = [fault("POST /v1/meshes", action, times=2)]
    mesh = connect(service.url).generate("x*y", 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({request.headers["idempotency-key"] for request in sent}) == 1
    assert len({request.body for request in sent}) == 1
    assert list(service.meshes) == [mesh.id]


def test_a_create_with_samples_is_repeated_with_the_same_bytes_and_key(connect: Any, service: Any, fault: Any) -> None:
    client = connect(service.url)
    service.faults = [fault("POST /v1/samples", "lose"), fault("POST /v1/samples", "status")]
    stored = client.samples.upload(np.ones((60, 60)))
    assert list(service.samples) == [stored.id]
    service.faults = [fault("POST /v1/meshes", "lose"), fault("POST /v1/meshes", "status", status=429)]
    client.generate(np.ones((60, 60)), 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({(request.headers["idempotency-key"], request.body) for request in sent}) == 1
    assert sent[0].headers["content-type"].startswith("multipart/")
    assert len(service.meshes) == 1


def test_retry_after_is_honoured(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert connect(service.url).capabilities() == {"formats": ["vtu", "npz"]}
    assert time.monotonic() - start > 0.95


def test_a_long_retry_after_is_the_callers_to_wait_for(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited) as caught:
        connect(service.url).capabilities()
    assert caught.value.retry_after == 3600
    assert len(service.requests) == 1


def test_a_service_that_keeps_failing_is_given_up(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=502, times=99)]
    with pytest.raises(ServerError) as caught:
        connect(service.url).capabilities()
    assert caught.value.status == 502
    assert len(service.requests) == 4


def test_an_internal_error_is_not_repeated(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=500)]
    with pytest.raises(ServerError):
        connect(service.url).capabilities()
    assert len(service.requests) == 1


@pytest.mark.parametrize(("status", "kind"), [(401, Unauthorized), (403, Forbidden), (410, Gone), (507, StorageFull)])
def test_what_does_not_get_better_is_not_repeated(
    connect: Any, service: Any, fault: Any, status: int, kind: type[ProblemError]
) -> None:
    service.faults = [fault("POST", "status", status=status, headers={"Retry-After": "1"})]
    with pytest.raises(kind):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 1


def test_a_quota_is_waited_for_as_long_as_it_is_short(connect: Any, service: Any, fault: Any) -> None:
    body = {"type": "/problems/quota-exceeded", "title": "Too much at a time"}
    service.faults = [fault("POST", "status", status=429, body=body, times=4)]
    with pytest.raises(QuotaExceeded):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 4


def test_nobody_there(connect: Any) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ServiceUnreachable, match="equimesh serve"):
            connect(url, retries=1).capabilities()


def test_somebody_else_there(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=200, body=["nothing"])]  # type: ignore[arg-type]
    with pytest.raises(ServiceUnreachable, match="not one of an equimesh service"):
        connect(service.url).capabilities()


def test_generate_cancels_what_nobody_waits_for(connect: Any, service: Any) -> None:
    with pytest.raises(DeadlineExceeded):
        connect(service.url).generate("x", 5, label="hang", deadline=0.4)
    assert service.meshes["m0"]["status"] == "canceled"


def test_generate_cancels_a_mesh_whose_id_never_arrived(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes$", "late")]
    with pytest.raises(DeadlineExceeded):
        connect(service.url).generate("x", 5, label="hang", deadline=0.4)
    assert list(service.meshes) == ["m0"]
    assert service.meshes["m0"]["status"] == "canceled"


def test_a_deadline_ends_retries(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes", times=999)]
    patient = RetryPolicy(retries=999, first=0.05, longest=0.05)
    with pytest.raises(DeadlineExceeded):
        connect(service.url, retries=patient).generate("x", 5, deadline=0.5)
    assert len(service.seen("POST", "meshes")) < 100  # 999 pauses would take 50 s


def test_a_cancel_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    service.faults = [fault("POST .*/cancel", "lose")]
    assert mesh.cancel().status == "canceled"
    assert len(service.seen("POST", "cancel")) == 2


def test_a_delete_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("DELETE", "lose")]
    mesh.delete()
    with pytest.raises(NotFound):
        mesh.delete()
    with pytest.raises(NotFound):
        mesh.refresh()
