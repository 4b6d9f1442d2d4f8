"""The queue: order, fencing of lost attempts, leases."""

from __future__ import annotations

import threading

import pytest

from equimesh_service.store.rows import Artifact, Claim, Lease, NewMesh
from equimesh_service.store.store import Store
from service.store.stores import ERROR, SPEC, Clock, add, claimed, status


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
    assert not store.queue.finish(old, files=[Artifact("mesh", "0" * 64, 1)])
    assert store.meshes.artifact("a", "mesh") is None
    assert status(store, "a") == "running"
    assert store.queue.finish(new)
    assert status(store, "a") == "succeeded"


def test_publishing_happens_only_for_the_attempt_that_counts(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)
    published: list[str] = []
    store.queue.cancel("a")
    assert not store.queue.finish(claim, publish=lambda _: published.append("late"))
    assert published == []


def test_a_failed_publication_leaves_the_mesh_running(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)

    def fail(_: object) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        store.queue.finish(claim, files=[Artifact("mesh", "0" * 64, 1)], publish=fail)
    assert status(store, "a") == "running"
    assert store.meshes.artifact("a", "mesh") is None


def test_a_mesh_fails_when_its_workers_are_lost_too_often(store: Store) -> None:
    add(store, "a")
    outcomes = [store.queue.lose(claimed(store), "gone", most=3, error=ERROR) for _ in range(3)]
    assert outcomes == ["queued", "queued", "failed"]
    row = store.meshes.get("a")
    assert row is not None
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
