"""Limits of each key: requests a minute, unfinished meshes and their points, waits, stored bytes."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import httpx
import pytest

from equimesh_service import Settings
from equimesh_service.admission.callers import ANYONE, Caller, Quotas
from equimesh_service.admission.computation import Request
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.errors import QuotaError
from equimesh_service.problems.problem import Problem
from equimesh_service.store.database import to_json
from equimesh_service.store.keys import Quota, QuotaStore
from equimesh_service.store.rows import NewMesh
from equimesh_service.store.store import Store
from service.conftest import SLOW, small, until
from service.guarded import Guarded

CALLER = Caller("0123456789ab", frozenset({"read", "write"}))
SPEC: dict[str, Any] = {"label": None, "grid": {"n_xi": 10, "n_eta": 10}, "cells": "quad"}


class Stored(QuotaStore):
    """A store of this many bytes that counts how often it sums them."""

    def __init__(self, size: int = 0) -> None:
        self.size, self.sums = size, 0

    def stored_bytes(self, key_id: str) -> int:  # noqa: ARG002
        self.sums += 1
        return self.size


class Clock:
    """A clock that is set by hand."""

    now = 6000.0

    def __call__(self) -> float:
        return self.now


def quotas(clock: Clock, **settings: int) -> Quotas:
    return Quotas(Settings(**{f"key_{name}": value for name, value in settings.items()}), Stored(), clock=clock)  # type: ignore[arg-type]


# Requests ----------------------------------------------------------------------------------------------------


def refusal(limited: Quotas, caller: Caller = CALLER) -> Problem | None:
    """The problem of a request."""
    try:
        limited.count_request(caller)
    except Problem as problem:
        return problem
    return None


def test_no_more_requests_in_a_minute_than_the_key_may_send() -> None:
    clock = Clock()
    limited = quotas(clock, requests_per_minute=60)
    sent: list[float] = []
    while clock.now < 6300:
        clock.now += 0.2  # five times too fast
        if refusal(limited) is None:
            sent.append(clock.now)
    assert all(sum(start <= moment < start + 60 for moment in sent) <= 60 for start in range(6000, 6300))
    assert len(sent) == 300


@pytest.mark.parametrize("pause", [0.0, 0.4, 2.9])
def test_after_the_named_time_there_is_room(pause: float) -> None:
    clock = Clock()
    limited = quotas(clock, requests_per_minute=20)
    for _ in range(3):
        while (refused := refusal(limited)) is None:
            clock.now += pause
        assert refused.name == "rate-limited"
        assert "20 requests a minute (EQUIMESH_KEY_REQUESTS_PER_MINUTE)" in refused.detail
        clock.now += int(refused.headers["Retry-After"])
        assert refusal(limited) is None


def test_keys_are_counted_apart_and_nobody_without_one() -> None:
    limited = quotas(Clock(), requests_per_minute=1)
    limited.count_request(CALLER)
    limited.count_request(Caller("another", CALLER.scopes))
    assert [limited.count_request(ANYONE) for _ in range(5)] == [{}] * 5
    unlimited = quotas(Clock(), requests_per_minute=0)
    assert [unlimited.count_request(CALLER) for _ in range(5)] == [{}] * 5


def test_answers_say_how_many_requests_are_left(guarded_service: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    count = Quotas.count_request
    with guarded_service.client("read") as client:
        answers = [client.get("/v1/samples/none"), client.get("/v1/meshes")]
        assert [answer.headers["ratelimit"].split(";")[1] for answer in answers] == ["r=599", "r=598"]
        assert answers[0].headers["ratelimit-policy"] == '"key";q=600;w=60'
        fifty: Any = lambda quotas, caller: [count(quotas, caller) for _ in range(50)][-1]  # noqa: E731
        monkeypatch.setattr(Quotas, "count_request", fifty)
        refused = next(answer for _ in range(24) if (answer := client.get("/v1/samples/none")).status_code == 429)
        assert refused.json()["type"] == "/problems/rate-limited"
        assert 1 <= int(refused.headers["retry-after"]) <= 61
        assert client.get("/readyz").status_code == 200


# Meshes ------------------------------------------------------------------------------------------------------


def test_a_key_has_so_many_unfinished_meshes_and_points(
    guarded_service: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Request] = []
    flying = ("m-of-a-worker",)
    begin = Dispatcher.begin_request
    monkeypatch.setattr(Dispatcher, "begin_request", lambda *call: (begun.append(call[-1]), begin(*call))[1])
    slow = {**SLOW, "grid": {"n_xi": 17, "n_eta": 17}, "schwarz": {**SLOW["schwarz"], "subdomains": [2, 1]}}
    with guarded_service.client("write") as client, guarded_service.client("write") as other:
        made = [client.post("/v1/meshes", json=slow) for _ in range(3)]
        try:
            assert [answer.status_code for answer in made] == [202] * 3
            refused = client.post("/v1/meshes", json=small())
            assert refused.status_code == 429
            assert refused.json()["type"] == "/problems/quota-exceeded"
            assert "3 unfinished meshes; the limit is 3 (EQUIMESH_KEY_MAX_QUEUED)" in refused.json()["detail"]
            assert int(refused.headers["retry-after"]) > 0
            assert client.delete(made.pop().headers["location"]).status_code == 204
            refused = client.post("/v1/meshes", json=small(grid={"n_xi": 22, "n_eta": 22}))
            assert f"{2 * 17 * 17} points in unfinished meshes; the limit is 1000" in refused.json()["detail"]
            assert other.post("/v1/meshes", json=small()).status_code == 202
            monkeypatch.setattr(Dispatcher, "in_flight", lambda *_: flying)
            assert "3 unfinished meshes" in client.post("/v1/meshes", json=small()).json()["detail"]
            looks = iter([flying, flying])
            monkeypatch.setattr(Dispatcher, "in_flight", lambda *_: next(looks, ()))  # it is refused
            let_in = client.post("/v1/meshes", json=small())
            assert let_in.status_code == 202
            made.append(let_in)
            monkeypatch.setattr(Dispatcher, "in_flight", lambda *_: flying)
        finally:
            for answer in made:
                client.delete(answer.headers["location"])
        while not begun:  # until a worker is free
            assert client.post("/v1/meshes", json=small(), headers={"Prefer": "wait=300"}).status_code == 201
    assert [request.quota.in_flight for request in begun if request.quota] == [flying]


def test_no_two_at_once_slip_past(database_url: str) -> None:
    store = Store(database_url)
    store.prepare()
    quota = Quota(queued=5, points=450)

    def add(number: int) -> str:
        try:
            return store.meshes.add(
                NewMesh(id=f"m-{number}", spec=SPEC, key_id="k" if number < 20 else "l"), quota=quota
            )
        except QuotaError as error:
            return error.limit

    try:
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(add, range(40)))
    finally:
        store.close()
    for own in (found[:20], found[20:]):
        assert sum(entry.startswith("m-") for entry in own) == 4
        assert set(own) - {f"m-{number}" for number in range(40)} == {"key_max_points"}


def test_points_are_counted_in_64_bits(database_url: str) -> None:
    store = Store(database_url)
    store.prepare()
    huge = {**SPEC, "grid": {"n_xi": 50_000, "n_eta": 50_000}}  # 2.5e9 points, more than 32 bits count
    quota = Quota(queued=0, points=6_000_000_000)
    try:
        for number in range(2):
            store.meshes.add(NewMesh(id=f"m-{number}", spec=huge, key_id="k"), quota=quota)
        with pytest.raises(QuotaError) as refused:
            store.meshes.add(NewMesh(id="m-2", spec=huge, key_id="k"), quota=quota)
    finally:
        store.close()
    assert (refused.value.limit, refused.value.used) == ("key_max_points", 5_000_000_000)


# Waits -------------------------------------------------------------------------------------------------------


def test_callers_without_a_key_share_their_waits() -> None:
    limited = Quotas(Settings(key_max_waits=2), Stored())
    with ExitStack() as open_waits:
        for caller in (ANYONE, ANYONE, CALLER):
            open_waits.enter_context(limited.count_wait(caller, 1.0))
        with pytest.raises(Problem, match="Callers without a key have 2 open waits") as refused:
            open_waits.enter_context(limited.count_wait(ANYONE, 1.0))
        assert int(refused.value.headers["Retry-After"]) > 0
        open_waits.enter_context(limited.count_wait(ANYONE, 0))  # is no wait
        open_waits.enter_context(limited.count_wait(CALLER, 1.0))
    with limited.count_wait(ANYONE, 1.0), limited.count_wait(ANYONE, 1.0):
        pass


def test_a_key_holds_so_many_waits_and_streams_open(guarded_service: Guarded) -> None:
    slow = {**SLOW, "grid": {"n_xi": 17, "n_eta": 17}, "schwarz": {**SLOW["schwarz"], "subdomains": [2, 1]}}
    with guarded_service.client("write") as client, guarded_service.client("admin") as other:
        place = client.post("/v1/meshes", json=slow).headers["location"]
        with ExitStack() as streams:
            for _ in range(3):
                streams.enter_context(client.stream("GET", f"{place}/events"))
            refused = [
                client.get(f"{place}/events"),
                client.get(f"{place}?wait=10"),
                client.post("/v1/meshes", json=small(), headers={"Prefer": "wait=10"}),
                client.post("/v1/sequences", json=small(), headers={"Prefer": "wait=10"}),
            ]
            assert [answer.status_code for answer in refused] == [429] * 4
            assert {answer.json()["type"] for answer in refused} == {"/problems/quota-exceeded"}
            assert "3 open waits and event streams; the limit is 3" in refused[0].json()["detail"]
            assert len(client.get("/v1/meshes").json()["items"]) == 1  # nothing was asked for
            assert client.get(place).status_code == 200
            assert other.get(f"{place}?wait=0.1").status_code == 200
        until(lambda: client.get(f"{place}?wait=0.1").status_code == 200)  # they were closed
        assert client.delete(place).status_code == 204


# Bytes -------------------------------------------------------------------------------------------------------


@pytest.mark.anyio
async def test_bytes_are_summed_now_and_then() -> None:
    clock, stored = Clock(), Stored(600)
    limited = Quotas(Settings(key_max_bytes=1000), stored, clock=clock)
    await limited.check_bytes(CALLER, 300)
    await limited.check_bytes(CALLER, 90)
    with pytest.raises(Problem) as refused:
        await limited.check_bytes(CALLER, 90)
    assert "990 bytes in files, samples and specs; the limit is 1000 (EQUIMESH_KEY_MAX_BYTES)" in refused.value.detail
    assert stored.sums == 1
    stored.size = 0  # they were deleted: who was refused is not held to the old sum for long
    clock.now += 0.6
    await limited.check_bytes(CALLER, 90)
    clock.now += 4.0
    await limited.check_bytes(CALLER)
    assert stored.sums == 2
    clock.now += 2.0
    await limited.check_bytes(CALLER)
    assert stored.sums == 3
    await limited.check_bytes(ANYONE, 10**9)


def test_what_is_stored_counts(guarded_service: Guarded) -> None:
    row, secret = guarded_service.key("write")
    rows = "".join(f"{i / 40},{j / 40},{i * j / 7}\n" for i in range(41) for j in range(41))
    with guarded_service.having(secret) as client:

        def upload(k: int) -> httpx.Response:
            return client.post("/v1/samples?filename=u.csv", content="x,y,u\n" + rows.replace(",0.0\n", f",{k}\n"))

        mesh = client.post("/v1/meshes", json=small(), headers={"Prefer": "wait=300"}).json()
        files = guarded_service.store.quotas.stored_bytes(row.id)
        assert files > 0
        sizes: list[int] = []
        while (answer := upload(len(sizes))).status_code == 201:
            sizes.append(answer.json()["size"])
            assert sum(sizes) < guarded_service.settings.key_max_bytes
        with_file = {"spec": json.dumps(small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}))}
        sent = {"samples": ("u.csv", "x,y,u\n" + 4 * rows, "text/csv")}
        assert client.post("/v1/meshes", data=with_file, files=sent).status_code == 429
        assert guarded_service.store.quotas.stored_bytes(row.id) == files + sum(sizes)
        assert answer.json()["type"] == "/problems/quota-exceeded"
        assert "EQUIMESH_KEY_MAX_BYTES" in answer.json()["detail"]
        assert client.delete(mesh["links"]["self"]).status_code == 204
        assert guarded_service.store.quotas.stored_bytes(row.id) == sum(sizes)
        until(lambda: client.post("/v1/meshes", json=small()).status_code == 202)


def test_samples_in_specs_count(guarded_service: Guarded) -> None:
    values = [[i * j / 7 for j in range(60)] for i in range(60)]
    spec = small(
        monitor={"kind": "arc_length", "u": {"grid": {"x": [i / 59 for i in range(60)], "y": [0, 1], "values": values}}}
    )
    spec["monitor"]["u"]["grid"]["y"] = spec["monitor"]["u"]["grid"]["x"]
    with guarded_service.client("write") as client:
        made = [client.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}) for _ in range(5)]
        # A reused mesh is not solved again, but its spec takes space.
        assert [answer.status_code for answer in made] == [201, 201, 201, 429, 429]
        assert "bytes in files, samples and specs; the limit is 200000" in made[-1].json()["detail"]
        assert client.delete(made[0].headers["location"]).status_code == 204
        until(lambda: client.post("/v1/meshes", json=spec).status_code in (201, 202))


def test_a_spec_counts_as_it_is_stored(database_url: str) -> None:
    store = Store(database_url)
    store.prepare()
    spec = {**SPEC, "label": "größer als ein Buchstabe \u2192"}
    for number in range(2):
        store.meshes.add(NewMesh(id=f"m-{number}", spec=spec, key_id="k"))
    assert store.quotas.stored_bytes("k") == 2 * len(to_json(spec).encode())
    assert store.quotas.stored_bytes("l") == 0
    store.close()
