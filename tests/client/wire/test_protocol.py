"""Requests, answers, deadlines and events as plain values, and what they look like as words."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from email.parser import BytesParser
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from equimesh_client import (
    BadArgument,
    Forbidden,
    Gone,
    InvalidInput,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
    RetryPolicy,
    ServerError,
    StorageFull,
    TooLarge,
    Unauthorized,
    Upload,
)
from equimesh_client.errors import EquimeshClientError
from equimesh_client.spec.request import MeshRequest
from equimesh_client.wire.protocol import (
    PAGE_RECORDS,
    Call,
    Pages,
    Reply,
    SequencePages,
    at_pointer,
    check_expression,
    create_mesh,
    format_of,
    get_mesh,
    json_bytes,
    mesh_of,
    mesh_plot,
    multipart,
    problem_of,
    sha256_of,
)
from equimesh_client.wire.settings import Deadline, Settings, headers_with_key, pause_before_retry, retry_after_of
from equimesh_client.wire.stream import Event, EventParser, RawEvent, StreamPosition
from equimesh_client.wire.transport import base_url

CALL = Call(method="GET", path="/")


def reply(status: int, body: Any, **headers: str) -> Reply:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    return Reply(status=status, headers=headers, body=data)


def test_json_cannot_carry_nan() -> None:
    with pytest.raises(BadArgument, match="JSON"):
        json_bytes({"b": float("nan")})
    with pytest.raises(BadArgument, match=r"/u/values/1/0 is NaN or infinite, as from a solver"):
        json_bytes({"a": 0.5, "u": {"values": [[1.0, 2.0], np.array([np.inf, 1.0])]}})
    with pytest.raises(BadArgument, match="JSON"):
        json_bytes({"b": object()})
    sent = {"b": np.float64(0.5), "n": np.int64(3), "x": np.ones(2)}
    assert json_bytes(sent) == b'{"b": 0.5, "n": 3, "x": [1.0, 1.0]}'


def test_multipart_is_what_parsers_read_and_the_same_each_time() -> None:
    parts = {"spec": Upload(filename="", data=b"{}"), "samples": Upload(filename='a"b\r\n.npz', data=b"\r\n--x\0")}
    kind, body = multipart(parts)
    assert multipart(parts) == (kind, body)
    message = BytesParser().parsebytes(b"Content-Type: " + kind.encode() + b"\r\n\r\n" + body)
    found = message.get_payload()
    assert [p.get_param("name", header="content-disposition") for p in found] == ["spec", "samples"]
    assert found[1].get_payload(decode=True) == b"\r\n--x\0"
    assert found[1].get_filename() == "a%22b%0D%0A.npz"


def test_an_id_stays_inside_its_segment() -> None:
    assert get_mesh("../x?y").path == "/v1/meshes/..%2Fx%3Fy"


def test_the_calls_of_a_create() -> None:
    request = MeshRequest(spec={"a": 1}, uploads=(), key="k")
    call = create_mesh(request, wait=0)
    assert call.headers == {"Accept": "application/json", "Idempotency-Key": "k", "Content-Type": "application/json"}
    assert create_mesh(request, wait=5).headers["Prefer"] == "wait=5"
    assert check_expression("x", {"c": 1.0}, 2.0).sent == {"expression": "x", "parameters": {"c": 1.0}, "t": 2.0}
    with pytest.raises(BadArgument, match="svg or png"):
        mesh_plot("m", "mesh", "gif")


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        *((401, Unauthorized), (403, Forbidden), (404, NotFound), (410, Gone), (413, TooLarge)),
        *((422, InvalidInput), (429, RateLimited), (507, StorageFull), (599, ServerError)),
    ],
)
def test_each_status_has_its_exception(status: int, kind: type[ProblemError]) -> None:
    error = problem_of(reply(status, {"type": "/problems/p", "title": "T", "detail": "D.", "remedy": "R."}), CALL)
    assert type(error) is kind
    assert isinstance(error, EquimeshClientError)
    assert (error.status, error.type, error.title, error.detail) == (status, "/problems/p", "T", "D.")
    assert str(error) == f"T: D (HTTP {status})\n{kind.advice or 'R.'}"


def test_a_quota_is_known_by_its_type_and_says_when_to_come_back() -> None:
    body = {"type": "/problems/quota-exceeded", "title": "T", "detail": "D"}
    error = problem_of(reply(429, body, **{"retry-after": "7"}), CALL)
    assert isinstance(error, QuotaExceeded)
    assert isinstance(error, RateLimited)
    assert str(error).splitlines()[-1] == "Try again in 7 s."


@pytest.mark.parametrize("body", [b"<html>", b"", b"[]", b"null", b"\xff", b'{"errors": 3, "detail": [1]}'])
def test_a_failure_with_any_body_is_a_problem(body: bytes) -> None:
    assert "Bad Gateway" in str(problem_of(reply(502, body), CALL))


def test_a_redirect_names_the_address() -> None:
    error = problem_of(reply(308, b"", location="https://there"), CALL)
    assert "https://there" in str(error)


def test_errors_replace_the_detail_and_show_a_caret_where_there_is_text() -> None:
    place = {"offset": 4, "line": 1, "column": 5}
    errors = [
        {"pointer": "/monitor/u/expression", "message": "unknown name", "position": place},
        {"pointer": "", "parameter": "limit", "message": "too large"},
        "nonsense",
    ]
    sent = {"monitor": {"u": {"expression": "1 + foo"}}}
    error = problem_of(reply(422, {"title": "T", "detail": "D", "errors": errors}), Call(method="", path="", sent=sent))
    assert str(error) == (
        "T (HTTP 422)\n  /monitor/u/expression: unknown name\n      1 + foo\n          ^\n  limit: too large"
    )
    assert [e.pointer for e in error.errors] == ["/monitor/u/expression", "limit"]


def test_pointers() -> None:
    document = {"a": [{"b/c": 1, "~": 2}]}
    assert at_pointer(document, "/a/0/b~1c") == 1
    assert at_pointer(document, "#/a/0/~0") == 2
    assert at_pointer(document, "") is document
    for lost in ("/a/1", "/x", "/a/0/b/c", "/a/-1"):
        assert at_pointer(document, lost) is None


def test_the_id_may_be_in_the_location() -> None:
    assert mesh_of(reply(202, {}, location="http://h/v1/meshes/m%20x"))["id"] == "m x"


def test_checksums_in_etags() -> None:
    digest = "0123456789abcdef" * 4
    for tag in (f'"{digest}"', f'W/"{digest.upper()}"', f'"sha256:{digest}"', f'"{digest}-gzip"'):
        assert sha256_of({"etag": tag}) == digest
    for tag in ('"abc"', f'"{digest}0"', ""):
        assert sha256_of({"etag": tag}) is None


def test_formats_by_suffix() -> None:
    assert format_of("a.foam.zip") == format_of(".") == "foam"
    assert format_of("a.xdmf.zip") == format_of("a.ZIP") == "xdmf"
    assert format_of("a.vtu", "npz") == "npz"
    with pytest.raises(BadArgument, match="suffix"):
        format_of("vtu")


def test_an_empty_id_is_no_mesh() -> None:
    with pytest.raises(BadArgument, match=r"the id of a mesh is a text, such as mesh\.id; not 3"):
        get_mesh(3)  # type: ignore[arg-type]
    with pytest.raises(BadArgument, match="id of a mesh is empty"):
        get_mesh("")


# Lists page by page: their limit, and where they end.


def fetched(pages: Pages, sizes: list[int]) -> list[int]:
    """The numbers of records that are taken of pages with so many; all but the last page name a next one."""
    taken = []
    for number, size in enumerate(sizes, start=1):
        assert pages.more
        cursor = None if number == len(sizes) else f"after-{number}"
        taken.append(len(pages.records({"items": [{}] * size, "next_cursor": cursor})))
    return taken


def test_a_list_without_a_limit_goes_on_to_its_last_page() -> None:
    pages = Pages(status=None, label=None, limit=None)
    assert fetched(pages, [PAGE_RECORDS, 3]) == [PAGE_RECORDS, 3]
    assert not pages.more


def test_no_more_records_are_asked_for_than_the_limit() -> None:
    pages = Pages(status="failed", label="a", limit=PAGE_RECORDS + 2)
    assert pages.next_call().query["limit"] == str(PAGE_RECORDS)
    assert len(pages.records({"items": [{}] * PAGE_RECORDS, "next_cursor": "next"})) == PAGE_RECORDS
    assert pages.next_call().query == {"limit": "2", "cursor": "next", "status": "failed", "label": "a"}
    assert len(pages.records({"items": [{}] * 5, "next_cursor": "more"})) == 2
    assert not pages.more
    assert not Pages(status=None, label=None, limit=0).more


def test_sequences_have_a_list_of_their_own() -> None:
    assert SequencePages(limit=7).next_call().path == "/v1/sequences"


def test_time_runs_down_to_zero() -> None:
    now = [10.0]
    deadline = Deadline.after(3.0, clock=lambda: now[0])
    assert deadline.left == 3.0
    now[0] = 12.5
    assert deadline.left == 0.5
    now[0] = 14.0
    assert deadline.left == 0.0
    assert str(deadline.exceeded("waiting")) == "waiting: the deadline of 3 s has passed"


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan, "9"])
def test_a_deadline_is_a_positive_number(seconds: float) -> None:
    with pytest.raises(BadArgument, match="positive number of seconds"):
        Deadline.after(seconds)


def test_a_plain_request_has_time_for_all_attempts() -> None:
    settings = Settings(url="http://h", timeout=2.0, policy=RetryPolicy(retries=4))
    assert settings.deadline().seconds == settings.attempts == 10.0
    assert settings.deadline(1.5).seconds == 1.5


# The API key: where it comes from and where it goes.


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_the_key_goes_with_every_request_and_nowhere_else(
    connect: Any, service: Any, fault: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_environment\n")
    connect(service.url).generate("x", 5)
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_1_environment"}
    requested = [
        ({"key": "em_2_given"}, "Bearer em_2_given"),
        ({"key": ""}, None),
        ({"headers": {"authorization": "Basic me"}}, "Basic me"),
    ]
    for options, header in requested:
        connect(service.url, **options).capabilities()
        assert service.requests[-1].headers.get("authorization") == header
    for options in ({"key": "em_2", "headers": {"AUTHORIZATION": "x"}}, {"key": "em 2"}, {"key": "em_\u00e4"}):
        with pytest.raises(BadArgument) as caught:
            connect(service.url, **options)
        assert "em_" not in str(caught.value)
        assert "em 2" not in str(caught.value)
    # a redirect is not followed: the key is for this address
    other = f"{service.url}/v1/elsewhere"
    service.faults = [fault("capabilities", "status", status=307, headers={"Location": other})]
    with pytest.raises(ProblemError, match=other):
        connect(service.url).capabilities()
    assert service.seen("GET", "elsewhere") == []


# Decisions about retries, without a network.


def policy(jitter: float = 1.0, retries: int = 3) -> RetryPolicy:
    return RetryPolicy(retries=retries, first=0.25, longest=1.0, patience=60.0, jitter=lambda: jitter)


def test_the_pause_doubles_up_to_the_longest() -> None:
    pauses = [pause_before_retry(policy(retries=9), k, status=None) for k in range(5)]
    assert pauses == [0.25, 0.5, 1.0, 1.0, 1.0]


def test_jitter_takes_at_most_half() -> None:
    assert pause_before_retry(policy(jitter=0.0), 1, status=503) == 0.25


def test_a_huge_attempt_number_does_not_overflow() -> None:
    assert policy().backoff(10**6) == 1.0


@pytest.mark.parametrize("status", [None, 429, 502, 503, 504])
def test_what_is_repeated(status: int | None) -> None:
    assert pause_before_retry(policy(), 2, status=status) is not None
    assert pause_before_retry(policy(), 3, status=status) is None


@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 410, 413, 415, 422, 500, 501, 507])
def test_what_is_not_repeated(status: int) -> None:
    assert pause_before_retry(policy(), 0, status=status) is None


def test_retry_after_counts_when_it_is_longer() -> None:
    assert pause_before_retry(policy(), 0, status=429, retry_after=7.0) == 7.0
    assert pause_before_retry(policy(), 0, status=429, retry_after=0.0) == 0.25
    assert pause_before_retry(policy(), 0, status=429, retry_after=61.0) is None


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        ("3", 3.0),
        (" 120 ", 120.0),
        ("Sat, 21 Nov 2026 12:00:10 GMT", 10.0),
        ("Sat, 21 Nov 2026 11:59:00 GMT", 0.0),
        ("Sat, 21 Nov 2026 12:00:10 -0000", 10.0),
        ("soon", None),
        ("-3", None),
        ("٣", None),
        ("", None),
    ],
)
def test_retry_after_is_a_number_or_a_date(value: str, seconds: float | None) -> None:
    now = datetime(2026, 11, 21, 12, tzinfo=UTC)
    assert retry_after_of({"retry-after": value}, now=now) == seconds


def test_a_policy_has_no_negative_number() -> None:
    with pytest.raises(BadArgument, match="retries = -1: give a number that is not negative"):
        RetryPolicy(retries=-1)
    with pytest.raises(BadArgument, match="first = '1': give a number"):
        RetryPolicy(first="1")  # type: ignore[arg-type]
    with pytest.raises(BadArgument, match="timeout = '30': give a positive number of seconds"):
        Settings(url="http://h", timeout="30", policy=RetryPolicy())  # type: ignore[arg-type]


OTHER_URLS = ["127.0.0.1:8000", "ftp://x", "http://", "nonsense", "http://[::1"]
PARTS_OF_A_SERVICE = ["http://h/v1/meshes", "http://h?x=1", "http://h/#x"]


@pytest.mark.parametrize("url", [*OTHER_URLS, *PARTS_OF_A_SERVICE])
def test_a_url_that_is_none(connect: Any, url: str) -> None:
    with pytest.raises(BadArgument):
        connect(url)


def test_a_key_ends_with_its_line_and_has_one() -> None:
    assert headers_with_key(None, "secret\n") == {"Authorization": "Bearer secret"}
    with pytest.raises(BadArgument, match="another character that no key has") as refused:
        headers_with_key(None, "sec\nret")
    assert "sec" not in str(refused.value)
    with pytest.raises(BadArgument, match="the key is no text: give one"):
        headers_with_key(None, 5)  # type: ignore[arg-type]


@pytest.mark.parametrize("end", ["", "/", "/v1", "/v1/"])
def test_the_path_of_a_service_is_kept(end: str) -> None:
    assert base_url(f"https://host:8000/a%20b%2Fc{end}") == "https://host:8000/a%20b%2Fc"
    assert base_url(f"http://[::1]:8000{end}") == "http://[::1]:8000"


def parsed(*chunks: bytes) -> list[RawEvent]:
    parser = EventParser()
    return [event for chunk in chunks for event in parser.feed(chunk)]


STREAM = (
    b'\xef\xbb\xbf: hello\r\n\r\nid: 1\nevent: status\ndata: {"a":\ndata: 1}\n\n'
    + "id:2\revent:progress\rdata:größe\r\rid: 3\r\ndata: x\r\n\r\n".encode()
    + b"id: 4\ndata: lost"
)
EVENTS = [
    RawEvent(id="1", kind="status", data='{"a":\n1}'),
    RawEvent(id="2", kind="progress", data="größe"),
    RawEvent(id="3", kind="message", data="x"),
]


def test_all_line_ends_comments_and_fields() -> None:
    assert parsed(STREAM) == EVENTS


@given(st.lists(st.integers(0, len(STREAM)), max_size=12))
def test_pieces_of_any_size_give_the_same(cuts: list[int]) -> None:
    bounds = [0, *sorted(cuts), len(STREAM)]
    assert parsed(*(STREAM[i:j] for i, j in pairwise(bounds))) == EVENTS


def test_an_event_without_data_is_none() -> None:
    assert parsed(b"id: 1\nevent: status\n\n") == []


def test_retry_is_in_milliseconds() -> None:
    parser = EventParser()
    parser.feed(b"retry: 1500\nretry: x\n\n")
    assert parser.retry == 1.5


def test_a_position_gives_every_event_once() -> None:
    position = StreamPosition()
    assert position.headers == {}
    first = position.feed(b"id: 1\nevent: status\ndata: {}\n\nid: 2\nevent: progress\ndata: 7\n\nid: 3\nda")
    assert first == [Event(id=1, kind="status", data={}), Event(id=2, kind="progress", data={"value": 7})]
    assert position.headers == {"Last-Event-ID": "2"}
    position.connected()
    again = position.feed(b"id: 2\nevent: progress\ndata: 7\n\nid: 3\nevent: done\ndata: {}\n\nid: 4\ndata: {}\n\n")
    assert [event.id for event in again] == [3]
    assert position.done


def test_a_new_event_forgives_failures() -> None:
    position = StreamPosition(failures=3)
    position.feed(b": still here\n\n")
    assert position.failures == 3
    position.feed(b"id: 1\nevent: status\ndata: {}\n\n")
    assert position.failures == 0


def test_a_message_without_a_number_is_a_keep_alive() -> None:
    assert StreamPosition().feed(b"event: ping\ndata: {}\n\nid: x\ndata: {}\n\n") == []
