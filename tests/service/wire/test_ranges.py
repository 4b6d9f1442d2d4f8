"""Ranges of a file over HTTP."""

from __future__ import annotations

from typing import Any

import httpx
import pytest


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
