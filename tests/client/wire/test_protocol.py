"""Requests and answers as plain values, and what they look like as words."""

from __future__ import annotations

import json
from email.parser import BytesParser
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    BadArgument,
    Forbidden,
    Gone,
    InvalidInput,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
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
