"""The whole OpenAPI document, against a real service: every answer is one that the document promises.

Requests come from schemathesis: valid ones, and ones that the schema forbids (:mod:`fuzz.cases`).
``FUZZ_CASES=20000 FUZZ_SEED=1 python -m pytest tests/fuzz -s -o faulthandler_timeout=0`` sends as many, and prints the
seed and a digest of the requests. Several are under way at once, as most wait for a worker or a file.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import httpx
import pytest
import requests
from schemathesis import APIOperation, Case
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    allow_header_conformance,
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
    unsupported_method,
)

from fuzz.cases import Digest, Request, boundary_requests, filled, operations_of, random_requests
from fuzz.conftest import chosen_seed, count_cases
from service.conftest import small, until

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
    response_headers_conformance,
    negative_data_rejection,
    unsupported_method,
    allow_header_conformance,
]
FEW = 60
BOUNDARY = 15_000
TESTS = Path(__file__).parents[1]
# Requests under way at once.
SENDERS = 8
# Requests that wait to be sent, so that a long run does not keep all of them in memory.
MAX_WAITING = 200


@dataclass
class Things:
    """Ids that are there: those that stay, and those that a case may take away."""

    stay: list[str]
    samples: list[str]
    go: deque[str] = field(default_factory=lambda: deque(maxlen=30))
    go_samples: deque[str] = field(default_factory=lambda: deque(maxlen=5))
    sequences: deque[str] = field(default_factory=lambda: deque(maxlen=30))

    def of(self, case: Case) -> list[str]:
        if "/samples" in case.path:
            return [*self.go_samples] if case.method == "DELETE" else [*self.samples, *self.go_samples]
        if "/sequences" in case.path:
            return [*self.sequences]
        if case.method == "DELETE" or case.path.endswith("/cancel"):
            return [*self.go]
        return [*self.stay, *self.go]

    def add(self, location: str) -> None:
        """Keep what a request has made."""
        place, _, name = location.rpartition("/")
        made = {"meshes": self.go, "sequences": self.sequences}.get(place.rpartition("/")[2], self.go_samples)
        made.append(name)


@pytest.fixture(scope="module")
def things(fuzz_http: httpx.Client) -> Things:
    """A mesh of every ending, and samples."""
    wait = {"Prefer": "wait=300"}
    specs = [
        small(schwarz={"overlap": 2, "tolerance": None, "max_iterations": 2}),
        small(schwarz={"overlap": 2, "max_iterations": 1, "fallback": False, "transmission": {"kind": "classical"}}),
        small(cells="triangle", label="label"),
    ]
    stay = [fuzz_http.post("/v1/meshes", json=spec, headers=wait).json()["id"] for spec in specs]
    for mesh in stay:
        until(lambda mesh=mesh: fuzz_http.get(f"/v1/meshes/{mesh}").json()["finished_at"])
    body = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}
    return Things(stay=stay, samples=[fuzz_http.post("/v1/samples", json=body).json()["id"]])


def _is_excused(check: Any, answer: Any) -> bool:
    """Whether this is a server error that says when to come back: no worker was free for a preview."""
    if check is not not_a_server_error or answer.status_code != 503:
        return False
    return answer.json()["type"].endswith("/problems/workers-busy") and "retry-after" in answer.headers


@dataclass(kw_only=True)
class Exchange:
    """Sends requests, and remembers what came back and what was wrong with it."""

    pool: ThreadPoolExecutor
    things: Things
    digest: Digest = field(default_factory=Digest)
    answers: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    failures: dict[tuple[str, int, str], str] = field(default_factory=dict)
    waiting: deque[Future[None]] = field(default_factory=deque)
    local: threading.local = field(default_factory=threading.local)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send(self, request: Request) -> None:
        """Have a request sent; waits while many are to be sent."""
        self.digest.add(request)
        self.waiting.append(self.pool.submit(self._send, request))
        while len(self.waiting) > MAX_WAITING:
            self.waiting.popleft().result()

    def _send(self, request: Request) -> None:
        case = request.case
        if isinstance(case.body, dict | list) and (body := filled(case.body, self.things.samples[0])) != case.body:
            case.body = body
        for number in request.numbers:
            if number is not None and (known := self.things.of(case)):
                case.path_parameters["id"] = known[number % len(known)]
            self._exchange(case)

    def _exchange(self, case: Case) -> None:
        if not hasattr(self.local, "session"):
            self.local.session = requests.Session()
        answer = case.call(session=self.local.session, timeout=600.0)
        label, status = case.operation.label, answer.status_code
        found: list[tuple[tuple[str, int, str], str]] = []
        try:
            case.validate_response(answer, checks=[check for check in CHECKS if not _is_excused(check, answer)])
        except BaseExceptionGroup as group:
            for error in group.exceptions:
                shown = f"{error}\n{case.as_curl_command()}\n{answer.content[:1000]!r}"
                found.append(((label, status, type(error).__name__), shown))
        if case.method == "POST" and status in (201, 202) and "location" in answer.headers:
            self.things.add(answer.headers["location"][0])
        with self.lock:
            self.answers[case.method, label, status] += 1
            for title, shown in found:
                if self.failures.setdefault(title, shown) is shown:
                    print(title, shown, flush=True)

    def report(self, name: str) -> None:
        """Wait for all answers, fail with everything that was wrong, and show what was sent and answered."""
        while self.waiting:
            self.waiting.popleft().result()
        for method, label, status in sorted(self.answers):
            print(self.answers[method, label, status], method, f"({label})", status)
        print(f"{name}: seed {chosen_seed()}, {self.digest.count} requests, digest {self.digest}", flush=True)
        assert not self.failures, "\n\n".join(f"{title}\n{text}" for title, text in self.failures.items())
        assert self.answers.total() == self.digest.count


@pytest.fixture
def exchange(things: Things) -> Iterator[Exchange]:
    with ThreadPoolExecutor(SENDERS) as pool:
        exchange = Exchange(pool=pool, things=things)
        yield exchange


@pytest.fixture(scope="module")
def operations(fuzz_http: httpx.Client, fuzz_url: str) -> list[APIOperation]:
    return operations_of(fuzz_http.get("/openapi.json").json(), fuzz_url)


def test_at_the_limits_of_the_schema(exchange: Exchange, operations: list[APIOperation]) -> None:
    every, rng = 1 if count_cases(0) else 400, Random(chosen_seed())
    # To make the cases of all keys of a spec takes seconds, and few of them are sent without FUZZ_CASES. Then all are
    # made before the first is sent: Hypothesis parses Python for them, which CPython 3.11 cannot do in two threads.
    most = None if every == 1 else 120
    made = (request for operation in operations for request in boundary_requests(operation, rng, every, most))
    for request in made if every == 1 else [*made]:
        exchange.send(request)
    exchange.report("at the limits")
    assert {label for _, label, _ in exchange.answers} == {operation.label for operation in operations}
    assert exchange.digest.count >= (BOUNDARY if every == 1 else 150)


def test_random_requests(exchange: Exchange, operations: list[APIOperation], fuzz_http: httpx.Client) -> None:
    wanted = max(FEW, count_cases(0) - BOUNDARY)
    random_requests(operations, chosen_seed(), wanted, exchange.send)
    exchange.report("at random")
    assert exchange.answers.total() >= wanted
    assert fuzz_http.get("/readyz").status_code == 200


# Headers that the document does not name, since HTTP has them for every file, and the status of a file for each.
CONDITIONS = {
    206: {"Range": "bytes=0-0"},
    304: {"If-None-Match": "*"},
    412: {"If-Match": '"another"'},
    416: {"Range": "bytes=999999999999-"},
}


def test_ranges_conditions_and_unknown_parameters_have_documented_answers(
    operations: list[APIOperation], things: Things
) -> None:
    places = {"number": 0, "name": "not-found"}
    of_file, of_parameter = dict.fromkeys(CONDITIONS, 0), 0
    for operation in operations:
        names = {parameter.name for parameter in operation.path_parameters}
        known = (things.samples if "/samples" in operation.path else things.stay)[0]
        path = {name: places.get(name, known) for name in names}
        about_key = "401" in operation.definition.raw["responses"]
        case = operation.Case(path_parameters=path | {"id": "none"} if names else path, query={"unknown": "1"})
        answer = case.call(timeout=600.0)
        case.validate_response(answer, checks=[not_a_server_error, status_code_conformance])
        assert (answer.status_code == 422) == about_key, operation.label
        of_parameter += about_key
        if operation.method != "get" or operation.path.endswith("/events"):
            continue
        whole = {"/v1/samples/{id}": {"format": "npz"}, "/v1/meshes/{id}/quality": {"arrays": "true"}}
        for status, headers in CONDITIONS.items():
            case = operation.Case(path_parameters=path, query=whole.get(operation.path, {}), headers=headers)
            answer = case.call(timeout=600.0)
            case.validate_response(answer, checks=[not_a_server_error, status_code_conformance])
            of_file[status] += answer.status_code == status
    assert of_file == dict.fromkeys(CONDITIONS, 6)  # file, quality, convergence, plot, drawing; samples
    assert of_parameter > 20


@pytest.mark.everything
def test_a_seed_gives_the_same_requests_in_another_process(fuzz_http: httpx.Client, tmp_path: Path) -> None:
    """The order of sets differs there, and nothing else may.

    Not in this process: Hypothesis uses constants of the modules that are loaded, which are those of other tests, too.
    """

    document = tmp_path / "openapi.json"
    document.write_bytes(fuzz_http.get("/openapi.json").content)

    def digests(hashes: str, *seeds: str) -> list[str]:
        environment = {**os.environ, "PYTHONPATH": str(TESTS), "PYTHONHASHSEED": hashes}
        command = [sys.executable, "-m", "fuzz.cases", str(document), "1", *seeds]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600, check=True)
        return done.stdout.splitlines()

    first, other = digests("1", "5", "6")
    assert digests("7", "5") == [first]
    assert other != first
