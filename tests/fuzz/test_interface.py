"""The whole OpenAPI document, against a real service: every answer is one that the document promises.

Requests come from schemathesis: valid ones, and ones that the schema forbids. Half of those with an id are given one
that is there, and half of the specs a function and a grid that can be solved, so that not all ends at the door.
``FUZZ_CASES=20000 python -m pytest tests/fuzz`` sends as many.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any

import httpx
import numpy as np
import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from schemathesis import APIOperation, Case, GenerationMode
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

from fuzz.conftest import count_cases
from service.conftest import small, until
from solver.upload.test_samples import npy, npz

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
FEW = 300
BOUNDARY = 15_000
EXPRESSIONS = ["x*y", "tanh(20*(x - y))", "1 + x", "where(x < 0.5, 1, 2)", "1/(x - 0.5)", "sin(", "k*x", "0"]
FILES = [b"x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,2\n", npz(x=[0, 1], y=[0, 1], values=np.eye(2)), npy(np.eye(3)), b"PK"]
DOMAINS: list[dict[str, Any]] = [
    {"kind": "rectangle", "x": [0, 2], "y": [-1, 1]},
    {"kind": "annulus_sector", "radii": [1, 2], "angles": [0, 90]},
    {
        "kind": "quadrilateral",
        "bottom": {"x": "3*t", "y": "0.2*sin(pi*t)"},
        "right": {"points": [[3, 0], [3, 1]]},
        "top": {"points": [[0, 1], [3, 1]]},
        "left": {"points": [[0, 0], [0, 1]]},
    },
]


RAW = ("x-npz", "x-npy", "zip", "vnd.vtk", "vnd.vtk.vtu+xml", "octet-stream")
for media_type in (f"application/{kind}" for kind in RAW):
    schemathesis.openapi.media_type(media_type, st.sampled_from(FILES) | st.binary(max_size=40))


@dataclass
class Things:
    """Ids that are there: those that stay, and those that a case may take away."""

    stay: list[str]
    samples: list[str]
    go: deque[str] = field(default_factory=lambda: deque(maxlen=30))
    go_samples: deque[str] = field(default_factory=lambda: deque(maxlen=5))

    def of(self, case: Case) -> list[str]:
        if "/samples" in case.path:
            return [*self.go_samples] if case.method == "DELETE" else [*self.samples, *self.go_samples]
        if case.method == "DELETE" or case.path.endswith("/cancel"):
            return list(self.go)
        return [*self.stay, *self.go]


@pytest.fixture(scope="module")
def things(fuzz_http: httpx.Client) -> Things:
    """A mesh of every ending, and samples."""
    wait = {"Prefer": "wait=30"}
    specs = [
        small(schwarz={"overlap": 2, "tolerance": None, "max_iterations": 2}),
        small(schwarz={"overlap": 2, "max_iterations": 1, "fallback": False, "transmission": {"kind": "classical"}}),
        small(cells="triangle", label="label"),
    ]
    stay = [fuzz_http.post("/v1/meshes", json=spec, headers=wait).json()["id"] for spec in specs]
    for mesh in stay:
        until(lambda mesh=mesh: fuzz_http.get(f"/v1/meshes/{mesh}").json()["finished_at"], 60)
    body = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}
    return Things(stay=stay, samples=[fuzz_http.post("/v1/samples", json=body).json()["id"]])


def mended(body: Any, choose: Callable[[Sequence[Any]], Any], things: Things) -> Any:
    """A spec as it came, but with a function, a grid and a domain that may be solved."""
    if isinstance(body, list):
        return [mended(member, choose, things) for member in body]
    if not isinstance(body, dict):
        return body
    found = {key: mended(member, choose, things) for key, member in body.items()}
    if isinstance(found.get("expression"), str):
        found["expression"] = choose(EXPRESSIONS)
    if isinstance(found.get("samples"), str):
        found["samples"] = choose([*things.samples, "upload"])
    if "monitor" in found:
        found["grid"] = {"n_xi": choose(range(4, 13)), "n_eta": choose(range(4, 13))}
    if "domain" in found:
        found["domain"] = choose(DOMAINS)
    return found


@dataclass(kw_only=True)
class Exchange:
    """Sends cases, and remembers what came back and what was wrong with it."""

    session: requests.Session
    things: Things
    answers: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    failures: dict[tuple[str, int, str], str] = field(default_factory=dict)

    def send(self, case: Case) -> None:
        answer = case.call(session=self.session, timeout=60)
        label, status = case.operation.label, answer.status_code
        self.answers[case.method, label, status] += 1
        try:
            case.validate_response(answer, checks=CHECKS)
        except BaseExceptionGroup as group:
            for error in group.exceptions:
                shown = f"{error}\n{case.as_curl_command()}\n{answer.content[:1000]!r}"
                title = (label, status, type(error).__name__)
                if title not in self.failures:
                    self.failures[title] = shown
                    print(title, shown, flush=True)
        if case.method == "POST" and status in (201, 202) and "location" in answer.headers:
            place, _, name = answer.headers["location"][0].rpartition("/")
            (self.things.go if place.endswith("meshes") else self.things.go_samples).append(name)

    def report(self) -> None:
        """Fail with everything that was wrong; show what was sent and answered."""
        for method, label, status in sorted(self.answers):
            print(self.answers[method, label, status], method, f"({label})", status)
        assert not self.failures, "\n\n".join(f"{title}\n{text}" for title, text in self.failures.items())


@pytest.fixture
def exchange(things: Things) -> Iterator[Exchange]:
    with requests.Session() as session:
        yield Exchange(session=session, things=things)


@pytest.fixture(scope="module")
def operations(fuzz_url: str) -> list[APIOperation]:
    schema = schemathesis.openapi.from_url(f"{fuzz_url}/openapi.json")
    return [result.ok() for result in schema.get_all_operations()]


def boundary_cases(operation: APIOperation) -> Iterator[Case]:
    """At and beside every limit of the schema, and methods that a path does not take."""
    schema = operation.schema
    config = schema.config.generation_for(operation=operation)
    return schema.iter_coverage_cases(operation, generation_modes=list(GenerationMode), generation_config=config)


def random_cases(operations: list[APIOperation]) -> st.SearchStrategy[Case]:
    """Valid requests, and, where there is more than a path to get wrong, invalid ones; more where there is more."""
    strategies: list[st.SearchStrategy[Case]] = []
    for operation in operations:
        weight = 8 if operation.method == "post" and operation.body else 1 + len([*operation.query])
        strategies += [operation.as_strategy(generation_mode=GenerationMode.POSITIVE)] * weight
        if operation.body or [*operation.query]:
            strategies += [operation.as_strategy(generation_mode=GenerationMode.NEGATIVE)] * (weight // 2)
    return st.sampled_from(strategies).flatmap(lambda strategy: strategy)


def test_at_the_limits_of_the_schema(exchange: Exchange, operations: list[APIOperation]) -> None:
    """Every case as it is; with an id that is there; with a spec that may be solved; with parts of another spec."""
    every, sent, rng = 1 if count_cases(0) else 60, 0, Random(1)
    for operation in operations:
        cases = list(boundary_cases(operation))
        for case in cases[:: every if len(cases) > 100 else 1]:
            for variant in variants(case, exchange.things, rng, [other.body for other in cases]):
                exchange.send(variant)
                sent += 1
    exchange.report()
    assert exchange.answers.total() == sent
    assert sent >= (BOUNDARY if every == 1 else 500)


def variants(case: Case, things: Things, rng: Random, bodies: list[Any]) -> Iterator[Case]:
    yield case
    if "id" in case.path_parameters and (known := things.of(case)):
        case.path_parameters["id"] = rng.choice(known)
        yield case
    if case.method == "POST" and isinstance(case.body, dict):
        body, other = case.body, rng.choice(bodies)
        merged = {
            **(other if isinstance(other, dict) else {}),
            **{key: body[key] for key in body if rng.random() < 0.5},
        }
        for new in (body, merged):
            yield case.operation.Case(
                method="POST",
                path_parameters=case.path_parameters,
                media_type=case.media_type,
                body=mended(new, rng.choice, things),
            )


def test_random_requests(exchange: Exchange, operations: list[APIOperation], fuzz_http: httpx.Client) -> None:
    wanted = max(FEW, count_cases(0) - BOUNDARY)

    @settings(
        max_examples=wanted,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=random_cases(operations), data=st.data())
    def send(case: Case, data: st.DataObject) -> None:
        number = data.draw(st.integers(0, 99))
        if "id" in case.path_parameters and (known := exchange.things.of(case)) and number < 70:
            case.path_parameters["id"] = known[number % len(known)]
        if case.method == "POST" and number < 60:
            case.body = mended(case.body, lambda choices: data.draw(st.sampled_from(choices)), exchange.things)
            if number < 50:
                case.query = {}
        exchange.send(case)

    send()
    exchange.report()
    assert exchange.answers.total() >= wanted
    assert fuzz_http.get("/readyz").status_code == 200
