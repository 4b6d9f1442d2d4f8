"""Ranges of a file over HTTP."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from equimesh_service.problems.problem import Problem
from equimesh_service.wire.sending import Span, parse_ranges


@pytest.mark.parametrize("header", ["bytes=5-2", "bytes=abc", "bytes=", "items=0-1", "bytes=--5", "bytes=1-,x"])
def test_a_range_that_is_none_is_ignored(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    assert (answer.status_code, answer.content) == (200, http.get(url).content)


@pytest.mark.parametrize("header", ["bytes=99999999-", "bytes=-0", f"bytes={'9' * 6000}-", "bytes=99999998-,-0"])
def test_a_range_past_the_end_is_a_problem(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    size = len(http.get(url).content)
    assert (answer.status_code, answer.headers["content-range"]) == (416, f"bytes */{size}")
    assert answer.headers["content-type"] == "application/problem+json"
    assert (answer.json()["type"], answer.json()["detail"]) == (
        "/problems/range-not-satisfiable",
        f"The file has {size} bytes.",
    )
    assert http.get(url, headers={"Range": f"{header},0-1"}).content == http.get(url).content[:2]


@pytest.mark.parametrize(
    ("header", "spans"),
    [
        (None, ()),
        ("bytes=0-0", (Span(0, 1),)),
        ("BYTES= 2-3 , -1", (Span(2, 4), Span(9, 10))),
        ("bytes=-99", (Span(0, 10),)),
        ("bytes=5-,0-1", (Span(5, 10), Span(0, 2))),
        ("bytes=0-1,10-", (Span(0, 2),)),  # what is past the end does not count while another part is there
        ("bytes=0-4,4-5", ()),  # one byte twice
        ("bytes=" + ",".join(f"{k}-{k}" for k in range(9)), tuple(Span(k, k + 1) for k in range(9))),
        ("bytes=3-2,0-1", ()),
    ],
)
def test_a_header_is_read_as_parts_of_ten_bytes(header: str | None, spans: tuple[Span, ...]) -> None:
    assert parse_ranges(header, 10) == spans


def test_an_empty_file_has_no_part() -> None:
    with pytest.raises(Problem) as caught:
        parse_ranges("bytes=0-", 0)
    assert (caught.value.name, caught.value.headers) == ("range-not-satisfiable", {"Content-Range": "bytes */0"})
    assert Span(3, 7).content_range(10) == "bytes 3-6/10"
