"""The requests of a fuzz run: a seed gives the same ones each time, on every machine.

Nothing here depends on answers. Where a request needs an id that is there, it has a number, which chooses one when the
request is sent. ``python -m fuzz.cases DOCUMENT COUNT SEED ...`` prints, for each seed, the digest of this many random
requests by the OpenAPI document in a file.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from schemathesis import APIOperation, Case, GenerationMode
from schemathesis.core import NotSet

from solver.upload.test_samples import npy, npz

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
# In a spec, the id of samples that are stored.
STORED = "stored samples"
# Numbers that choose an id among those that are there.
MAX_NUMBER = 10_000

RAW = ("x-npz", "x-npy", "zip", "vnd.vtk", "vnd.vtk.vtu+xml", "octet-stream")
for media_type in (f"application/{kind}" for kind in RAW):
    schemathesis.openapi.media_type(media_type, st.sampled_from(FILES) | st.binary(max_size=40))


@dataclass(frozen=True, kw_only=True)
class Request:
    """A case, and how often it is sent: each time as it is (None), or with an id that a number chooses."""

    case: Case
    numbers: tuple[int | None, ...] = (None,)

    def describe(self) -> str:
        """Equal for equal requests, whatever ids the service gives."""
        case = self.case
        parts = (case.path_parameters, case.query, dict(case.headers), case.cookies, case.body)
        return repr((case.method, case.path, case.media_type, *map(_plain, parts), self.numbers))


class Digest:
    """A hash of all requests in their order, and their number."""

    def __init__(self) -> None:
        self._hash = sha256()
        self.count = 0

    def add(self, request: Request) -> None:
        self._hash.update(request.describe().encode("utf-8", "backslashreplace"))
        self.count += len(request.numbers)

    def __str__(self) -> str:
        return self._hash.hexdigest()[:16]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return sorted((repr(key), _plain(member)) for key, member in value.items())
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    return "" if isinstance(value, NotSet) else repr(value)


def operations_of(document: dict[str, Any], url: str) -> list[APIOperation]:
    """All operations of an OpenAPI document."""
    schema = schemathesis.openapi.from_dict(document)
    schema.config.update(base_url=url)
    return [result.ok() for result in schema.get_all_operations()]


def mended(body: Any, choose: Callable[[Sequence[Any]], Any]) -> Any:
    """A spec as it came, but with a function, a grid and a domain that may be solved."""
    if isinstance(body, list):
        return [mended(member, choose) for member in body]
    if not isinstance(body, dict):
        return body
    found = {key: mended(member, choose) for key, member in body.items()}
    if isinstance(found.get("expression"), str):
        found["expression"] = choose(EXPRESSIONS)
    if isinstance(found.get("samples"), str):
        found["samples"] = choose([STORED, "upload"])
    if "monitor" in found:
        found["monitor"] = _quick(found["monitor"], choose)
        found["grid"] = {"n_xi": choose(range(4, 13)), "n_eta": choose(range(4, 13))}
    if "domain" in found:
        found["domain"] = choose(DOMAINS)
    return found


def _quick(monitor: Any, choose: Callable[[Sequence[Any]], Any]) -> Any:
    """Mostly an arc length in place of a monitor that tries many meshes, half a second of processor time for each."""
    slow = isinstance(monitor, dict) and monitor.get("kind", "auto") in ("auto", "least_error")
    return {"kind": "arc_length", "u": monitor["u"]} if slow and "u" in monitor and choose(range(10)) else monitor


def filled(body: Any, samples: str) -> Any:
    """A body with the id of stored samples in place of :data:`STORED`."""
    if isinstance(body, list):
        return [filled(member, samples) for member in body]
    if isinstance(body, dict):
        return {key: filled(member, samples) for key, member in body.items()}
    return samples if isinstance(body, str) and body == STORED else body


def boundary_requests(operation: APIOperation, rng: Random, every: int, most: int | None = None) -> Iterator[Request]:
    """At and beside every limit of the schema, and methods that a path does not take.

    ``every`` leaves cases out, fewer of an operation that has few. Only the first ``most`` cases are made, if it is
    given: all of those of a spec take seconds.

    Each case as it is; with an id that is there; with a spec that may be solved; with parts of another spec.
    """
    schema = operation.schema
    config = schema.config.generation_for(operation=operation)
    modes = list(GenerationMode)
    made = schema.iter_coverage_cases(operation, generation_modes=modes, generation_config=config)
    cases = list(islice(made, most))
    bodies = [case.body for case in cases]
    for case in cases[:: every if len(cases) > 100 else max(1, every // 80)]:
        with_id = (rng.randrange(MAX_NUMBER),) if "id" in case.path_parameters else ()
        yield Request(case=case, numbers=(None, *with_id))
        if case.method == "POST" and isinstance(case.body, dict):
            yield from _merged(case, rng, bodies, with_id or (None,))


def _merged(case: Case, rng: Random, bodies: list[Any], numbers: tuple[int | None, ...]) -> Iterator[Request]:
    body, other = case.body, rng.choice(bodies)
    assert isinstance(body, dict)
    merged = {**(other if isinstance(other, dict) else {}), **{key: body[key] for key in body if rng.random() < 0.5}}
    for new in (body, merged):
        changed = case.operation.Case(
            method="POST",
            path_parameters=dict(case.path_parameters),
            media_type=case.media_type,
            body=mended(new, rng.choice),
        )
        yield Request(case=changed, numbers=numbers)


def random_requests(operations: list[APIOperation], number: int, count: int, send: Callable[[Request], None]) -> None:
    """Send ``count`` random requests of the seed ``number``.

    They are valid, and, where there is more than a path to get wrong, invalid; more where there is more. Half of those
    with an id get one that is there, and half of the specs a function and a grid that can be solved, so that not all
    ends at the door.
    """
    strategies: list[st.SearchStrategy[Case]] = []
    for operation in operations:
        weight = 8 if operation.method == "post" and operation.body else 1 + len([*operation.query])
        strategies += [operation.as_strategy(generation_mode=GenerationMode.POSITIVE)] * weight
        if operation.body or [*operation.query]:
            strategies += [operation.as_strategy(generation_mode=GenerationMode.NEGATIVE)] * (weight // 2)
    cases: st.SearchStrategy[Case] = st.sampled_from(strategies).flatmap(lambda strategy: strategy)

    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=cases, data=st.data())
    def each(case: Case, data: st.DataObject) -> None:
        drawn = data.draw(st.integers(0, 99))
        # A body of bytes stays: schemathesis checks what is set anew, and would take all bytes for invalid text.
        if case.method == "POST" and drawn < 60 and isinstance(case.body, dict | list):
            case.body = mended(case.body, lambda choices: data.draw(st.sampled_from(choices)))
            if drawn < 50:
                case.query = {}
        has_id = "id" in case.path_parameters and drawn < 70
        send(Request(case=case, numbers=(drawn,) if has_id else (None,)))

    each()


def digest_of(operations: list[APIOperation], number: int, count: int) -> str:
    """The digest of the first boundary cases and of random requests, without a service."""
    digest = Digest()
    for operation in operations:
        if operation.path == "/v1/expressions/check":
            for request in boundary_requests(operation, Random(number), 5, 120):
                digest.add(request)
    random_requests(operations, number, count, digest.add)
    return f"{digest.count} {digest}"


if __name__ == "__main__":
    # Those of expressions and samples; strategies for the others are made in the same way, and take long.
    every = operations_of(json.loads(Path(sys.argv[1]).read_text()), "http://127.0.0.1:1")
    some = [operation for operation in every if operation.path.startswith(("/v1/expressions", "/v1/samples"))]
    for chosen in sys.argv[3:]:
        print(digest_of(some, int(chosen), int(sys.argv[2])))
