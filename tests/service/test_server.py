"""The server on its port: answers are sent at once, also to many simultaneous requests."""

from __future__ import annotations

import threading
import time
from typing import Any

import httpx

from service.conftest import small
from service.requests import WAIT


def test_small_answers_are_sent_at_once(http: httpx.Client, finished: dict[str, Any]) -> None:
    def seconds() -> float:
        began = time.perf_counter()
        http.get(finished["links"]["self"])
        return time.perf_counter() - began

    assert any(seconds() < 0.03 for _ in range(300)), "Nagle's algorithm holds every answer back for 40 ms"


def test_the_same_expression_under_load(url: str) -> None:
    answers: list[httpx.Response] = []

    def ask() -> None:
        with httpx.Client(base_url=url, timeout=60.0) as client:
            answers.append(client.post("/v1/meshes?format=npz", json=small(), headers=WAIT))

    threads = [threading.Thread(target=ask) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.headers["etag"] for answer in answers}) == 1
