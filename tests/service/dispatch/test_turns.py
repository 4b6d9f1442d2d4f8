"""Keys take turns: whatever waits of one key, the first task of another is next when a running one ends."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import update

from equimesh_service.dispatch.worker_line import Contender, KeyedLine, Turns
from equimesh_service.store.schema import meshes
from equimesh_service.store.store import Store
from service.conftest import small, until
from service.guarded import Guarded
from service.requests import solved
from service.store.stores import add_backlog


def _start(turns: Turns, shares: dict[str, int], running: Counter[str]) -> str:
    """Start a task of the key whose turn it is, of keys that always have one waiting."""
    contenders = [Contender(key_id=key, share=share, running=running[key]) for key, share in shares.items()]
    first = turns.first(contenders)
    turns.start(first.key_id, first.share)
    return first.key_id


def test_a_backlog_delays_nobody() -> None:
    turns, idle = Turns(), Counter[str]()
    assert [_start(turns, {"a": 1}, idle) for _ in range(1000)] == ["a"] * 1000
    assert [_start(turns, {"a": 1, "b": 1}, idle) for _ in range(4)] == ["b", "a", "b", "a"]


@pytest.mark.parametrize("workers", [1, 4])
def test_keys_get_their_shares(workers: int) -> None:
    turns, running, ends = Turns(), Counter[str](), list[str]()
    started = Counter[str]()
    for number in range(400):
        key = _start(turns, {"a": 1, "b": 3}, running)
        started[key] += 1
        if workers == 1:
            continue
        ends.append(key)
        running[key] += 1
        if number >= workers - 1:
            running[ends.pop(0)] -= 1
    assert started == {"a": 100, "b": 300}


def test_long_tasks_of_one_key_leave_workers_to_others() -> None:
    turns = Turns()
    # Of two workers one is held by a long task of a: the other one serves b, however often.
    assert {_start(turns, {"a": 1, "b": 1}, Counter(a=1)) for _ in range(100)} == {"b"}
    assert _start(turns, {"a": 1, "b": 1}, Counter()) == "a"


def test_an_idle_key_saves_nothing_up() -> None:
    turns, idle = Turns(), Counter[str]()
    for _ in range(100):
        _start(turns, {"a": 1}, idle)
    assert Counter(_start(turns, {"a": 1, "b": 1}, idle) for _ in range(20)) == {"a": 10, "b": 10}


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.integers(1, 5)), min_size=1, max_size=60), st.integers(1, 9))
def test_a_key_that_runs_nothing_waits_for_one_round(history: list[tuple[str, int]], share: int) -> None:
    turns = Turns()
    for key, weight in history:
        turns.start(key, weight)
    shares = {**dict(history), "late": share}
    order = [_start(turns, shares, Counter()) for _ in range(len(shares))]
    assert "late" in order  # at most one start of each other key, however large its share
    assert turns.first([Contender(key_id="late"), Contender(key_id="new", running=1)]).key_id == "late"


def test_what_is_remembered_does_not_grow() -> None:
    turns = Turns()
    for number in range(1000):
        turns.start(str(number))
        turns.start("always")
    assert len(turns._next) < 5


def test_a_line_keeps_the_order_of_each_key() -> None:
    line = KeyedLine[int]()
    for number in range(6):
        line.add("ab"[number % 2], number, share=1 + number % 2)
    assert line.remove(2)
    assert not line.remove(2)
    assert [(key.key_id, key.share, key.running) for key in line.contenders({"b": 7})] == [("a", 1, 0), ("b", 2, 7)]
    assert [line.pop("a"), line.pop("a"), line.pop("b")] == [0, 4, 1]
    assert [key.key_id for key in line.contenders({})] == ["b"]
    assert (len(line), line.pop_all(), len(line)) == (2, [3, 5], 0)


def test_the_first_mesh_of_a_key_passes_the_backlog_of_another(guarded_service: Guarded) -> None:
    store = guarded_service.store
    (heavy, _), (light, secret) = guarded_service.key("write"), guarded_service.key("write")
    with guarded_service.having(secret) as client:
        spec = store.meshes.spec(solved(client, small())["id"])
        assert spec is not None
        add_backlog(store, 1000, heavy.id, spec)
        until(lambda: any(row.started_at for row in store.meshes.page(key_id=heavy.id, limit=1000)))
        mesh_id = client.post("/v1/meshes", json=small(grid={"n_xi": 9, "n_eta": 9})).json()["id"]
        before = _starts(store, heavy.id)  # at the latest when the new mesh waited
        until(lambda: client.get(f"/v1/meshes/{mesh_id}").json()["status"] == "succeeded")
        until(lambda: len(_starts(store, heavy.id)) > len(before))
    with store.database.write() as connection:
        connection.execute(update(meshes).where(meshes.c.status == "queued").values(status="canceled"))
    start = _starts(store, light.id)[mesh_id]
    after = {name: time for name, time in _starts(store, heavy.id).items() if name not in before}
    # The dispatcher may have chosen one mesh just before the new one was there.
    assert sum(time < start for time in after.values()) <= 1


def _starts(store: Store, key_id: str) -> dict[str, float]:
    """When those meshes of a key started that have."""
    rows = store.meshes.page(key_id=key_id, limit=2000)
    return {row.id: row.started_at for row in rows if row.started_at is not None}
