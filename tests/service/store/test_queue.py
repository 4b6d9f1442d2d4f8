"""The queue: order, fencing of lost attempts, leases."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from equimesh_service.store import queue
from equimesh_service.store.rows import Artifact, Claim, KeysInQueue, Lease, NewMesh, Outcome
from equimesh_service.store.store import Store
from service.store.stores import ERROR, SPEC, Clock, add, add_backlog, claimed, status


def test_oldest_mesh_is_claimed_first_and_only_once(store: Store) -> None:
    add(store, "a")
    add(store, "b")
    assert [store.queue.claim("me", 10.0), store.queue.claim("me", 10.0), store.queue.claim("me", 10.0)] == [
        Claim("a", 1),
        Claim("b", 1),
        None,
    ]


def test_concurrent_claims_never_share_a_mesh(store: Store) -> None:
    for number in range(20):
        add(store, f"m{number}")
    claims: list[Claim | None] = []

    def take() -> None:
        claims.extend(store.queue.claim(threading.current_thread().name, 10.0) for _ in range(5))

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({claim.mesh_id for claim in claims if claim}) == 20


def test_a_lost_attempt_cannot_write(store: Store) -> None:
    add(store, "a")
    old = claimed(store)
    assert store.queue.lose(old, "gone", most=3, error=ERROR) == "queued"
    new = claimed(store)
    assert not store.queue.progress(old, {"fraction": 0.9})
    assert not store.queue.finish(old, Outcome(files=[Artifact("mesh", "0" * 64, 1)]))
    assert store.meshes.artifact("a", "mesh") is None
    assert status(store, "a") == "running"
    assert store.queue.finish(new)
    assert status(store, "a") == "succeeded"


def test_publishing_happens_only_for_the_attempt_that_counts(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)
    published: list[str] = []
    store.queue.cancel("a")
    assert not store.queue.finish(claim, Outcome(publish=lambda _: published.append("late")))
    assert published == []


def test_a_failed_publication_leaves_the_mesh_running(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)

    def fail(_: object) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        store.queue.finish(claim, Outcome(files=[Artifact("mesh", "0" * 64, 1)], publish=fail))
    assert status(store, "a") == "running"
    assert store.meshes.artifact("a", "mesh") is None


def test_a_mesh_fails_when_its_workers_are_lost_too_often(store: Store) -> None:
    add(store, "a")
    outcomes = [store.queue.lose(claimed(store), "gone", most=3, error=ERROR) for _ in range(3)]
    assert outcomes == ["queued", "queued", "failed"]
    row = store.meshes.get("a")
    assert (row.attempt, row.error) == (3, ERROR)


def test_a_stop_of_the_service_does_not_count_as_a_loss(store: Store) -> None:
    add(store, "a")
    for _ in range(5):
        assert store.queue.requeue(claimed(store), "stopped")
    assert store.queue.lose(claimed(store), "gone", most=3, error=ERROR) == "queued"


def test_leases_run_out_unless_they_are_renewed(store: Store, clock: Clock) -> None:
    add(store, "a")
    claim = claimed(store)
    clock.now += 9.0
    assert store.queue.find_abandoned() == []
    assert store.queue.renew("me", 10.0) == {claim}
    clock.now += 9.0
    assert store.queue.find_abandoned() == []
    clock.now += 2.0
    assert store.queue.find_abandoned() == [claim]


def test_a_new_owner_sees_what_another_one_left(store: Store) -> None:
    add(store, "a")
    claim = claimed(store, "old")
    assert store.queue.find_abandoned(owner_gone="old") == []
    assert store.queue.find_abandoned(owner_gone="new") == [claim]


def test_cancel_works_until_the_end(store: Store) -> None:
    add(store, "a")
    assert store.queue.cancel("a")
    assert not store.queue.cancel("a")
    assert not store.queue.cancel("nothing")
    assert store.meshes.events("a")[-1].data == {"status": "canceled"}


def test_a_mesh_that_somebody_waits_for_is_claimed_from_the_start(store: Store, clock: Clock) -> None:
    lease = Lease(owner="me", seconds=10.0)
    store.meshes.add(NewMesh(id="a", spec=SPEC), lease=lease)
    assert store.queue.claim("other", 10.0) is None
    assert [event.data["status"] for event in store.meshes.events("a")] == ["queued", "running"]
    assert store.queue.renew("me", 10.0) == {Claim("a", 1)}
    clock.now += 11.0
    assert store.queue.find_abandoned() == [Claim("a", 1)]
    assert store.queue.finish(Claim("a", 1))
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]


def test_the_keys_that_wait_come_with_their_shares_and_running_meshes(store: Store) -> None:
    assert store.queue.find_waiting() == KeysInQueue(shares={}, running={})
    row, _ = store.keys.create("heavy", ["write"], share=3)
    for number, key_id in enumerate(("z", row.id, "", "z", "a", "z")):
        store.meshes.add(NewMesh(id=f"m{number}", spec=SPEC, key_id=key_id))
    for _ in range(2):
        claimed(store, key_id="z")
    found = store.queue.find_waiting()
    assert list(found.shares.items()) == [(row.id, 3), ("", 1), ("a", 1), ("z", 1)]  # the oldest mesh first
    assert found.running == {"z": 2}
    assert store.queue.claim("me", 10.0, "b") is None
    assert claimed(store, key_id="a").mesh_id == "m4"


def test_a_look_and_a_claim_read_as_much_for_any_backlog(store: Store) -> None:
    read = list[int]()
    for backlog in (20, 1000):
        add_backlog(store, backlog, f"a{backlog}")
        add_backlog(store, 1, f"b{backlog}")
        read.append(_count_reads(store, f"a{backlog}"))
        assert store.queue.cancel(f"a{backlog}-0")
    # On the second look there are two keys more.
    assert 0 < read[1] <= 3 * read[0]


def _count_reads(store: Store, key_id: str) -> int:
    """The rows that a look at the queue and a claim read, in PostgreSQL; the steps of the machine of SQLite."""
    count = 0

    def step() -> int:
        nonlocal count
        count += 1
        return 0

    def add(plan: dict[str, Any]) -> None:
        nonlocal count
        removed = plan.get("Rows Removed by Filter", 0)
        count += int((plan["Actual Rows"] + removed) * plan["Actual Loops"]) if "Scan" in plan["Node Type"] else 0
        for part in plan.get("Plans", ()):
            add(part)

    with store.database.read() as connection:
        driver: Any = connection.connection.driver_connection
        for query in (queue._KEYS_IN_QUEUE, queue._RUNNING_OF_KEYS, queue._OLDEST_OF_KEY.params(key=key_id)):
            if connection.dialect.name == "sqlite":
                driver.set_progress_handler(step, 1)
                connection.execute(query).all()
                driver.set_progress_handler(None, 1)
            else:
                sql = query.compile(dialect=connection.dialect, compile_kwargs={"literal_binds": True})
                add(connection.exec_driver_sql(f"EXPLAIN (ANALYZE, FORMAT JSON) {sql}").scalar_one()[0]["Plan"])
    return count
