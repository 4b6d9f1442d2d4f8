"""New meshes that workers have: finished before the store knows of them, or entered while they run."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_service.errors import KeyReusedError, QuotaError
from equimesh_service.files.port import Removed
from equimesh_service.store import keys
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Artifact, Claim, Lease, NewEntry, NewMesh, NewSamples, Outcome, SamplesRow
from equimesh_service.store.store import Store
from service.store.stores import ERROR, SPEC, Clock, claimed, status

LEASE = Lease(owner="me", seconds=10.0)
SENT = NewSamples(SamplesRow("s-1", "5" * 64, 3, {"kind": "grid"}, 1000.0), b"npz")
FILE = Artifact("mesh", "0" * 64, 1)


def entry(mesh_id: str = "a", *, samples: NewSamples | None = None, key: str | None = None) -> NewEntry:
    names = () if samples is None else (samples.row.id,)
    new = NewMesh(id=mesh_id, spec=SPEC, samples=names, fingerprint=mesh_id, key_id="k")
    return NewEntry(new=new, samples=samples, key=key, fingerprint="f")


def finish(store: Store, made: NewEntry, outcome: Outcome | None = None, published: list[str] | None = None) -> str:
    published = [] if published is None else published

    def publish(name: str) -> Any:
        def note(_: Removed) -> None:
            published.append(name)

        return note

    outcome = replace(outcome or Outcome(result={}, files=[FILE]), publish=publish("mesh"))
    return store.meshes.add_finished(made, outcome, seconds=2.0, publish_samples=publish("samples"))


def enter(store: Store, made: NewEntry, quota: Quota | None = None) -> str:
    return store.meshes.add(made.new, key=made.key, fingerprint=made.fingerprint, quota=quota, lease=LEASE)


def test_a_finished_mesh_enters_with_its_samples_files_and_story(store: Store) -> None:
    published: list[str] = []
    assert finish(store, entry(samples=SENT), published=published) == "a"
    row = store.meshes.get("a")
    assert row is not None
    assert (row.status, row.attempt, row.created_at, row.finished_at) == ("succeeded", 1, 998.0, 1000.0)
    assert store.meshes.artifact("a", "mesh") == FILE
    assert store.samples.get("s-1", "k") == SENT.row
    assert [event.data["status"] for event in store.meshes.events("a")] == ["queued", "running", "succeeded"]
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]
    assert published == ["samples", "mesh"]
    assert store.queue.claim("me", 10.0, "k") is None


def test_it_may_have_failed(store: Store) -> None:
    assert finish(store, entry(), Outcome(error=ERROR, partial=True)) == "a"
    row = store.meshes.get("a")
    assert row is not None
    assert (row.status, row.error, row.partial) == ("failed", ERROR, True)
    assert store.meshes.events("a")[-1].data == {"status": "failed", "error": ERROR}


def test_a_mesh_that_is_entered_runs_and_its_worker_ends_it(store: Store) -> None:
    assert enter(store, entry()) == "a"
    assert status(store, "a") == "running"
    assert store.queue.find_held("me") == {Claim("a", 1)}
    assert store.queue.finish(Claim("a", 1))
    assert status(store, "a") == "succeeded"
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "done"]


def test_samples_of_a_mesh_that_is_entered_are_kept_before(store: Store) -> None:
    store.samples.keep(SENT, "k")
    store.samples.keep(SENT, "k")
    assert enter(store, entry(samples=SENT)) == "a"
    assert store.samples.get("s-1", "k") == SENT.row
    assert store.samples.get("s-1", "other") is None


def test_an_entered_mesh_whose_service_is_silent_is_taken_over(store: Store, clock: Clock) -> None:
    enter(store, entry())
    clock.now += 11.0
    assert store.queue.find_abandoned() == [Claim("a", 1)]
    assert store.queue.lose(Claim("a", 1), "silent", most=3, error=ERROR) == "queued"
    assert not store.queue.finish(Claim("a", 1))  # the first attempt is over
    assert claimed(store, "other", "k") == Claim("a", 2)


@pytest.mark.parametrize("entered", [False, True])
def test_the_same_key_gives_the_same_mesh(store: Store, entered: bool) -> None:
    first, second = entry("a", key="x"), entry("b", key="x")
    assert not store.meshes.has_key("k", "x")
    assert enter(store, first) == "a" if entered else finish(store, first) == "a"
    assert store.meshes.has_key("k", "x")
    assert not store.meshes.has_key("other", "x")
    assert finish(store, second) == "a"
    assert enter(store, second) == "a"
    assert store.meshes.get("b") is None
    with pytest.raises(KeyReusedError):
        finish(store, replace(second, fingerprint="other"))


def test_of_requests_with_the_same_key_there_is_one_mesh(store: Store) -> None:
    barrier, found = threading.Barrier(4), []

    def run(do: Any) -> None:
        barrier.wait()
        found.append(do())

    store.samples.keep(SENT, "k")
    made = [entry(name, samples=SENT, key="x") for name in "abcd"]
    acts = [lambda one=one, do=do: do(store, one) for one, do in zip(made, [finish, enter] * 2, strict=True)]
    threads = [threading.Thread(target=run, args=(act,)) for act in acts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert {row.id for row in store.meshes.page()} == set(found)
    assert len(set(found)) == 1


def test_the_quota_holds_for_meshes_that_are_entered(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    store.quotas.check("k", 64, lambda: quota)
    enter(store, entry("a"), quota)
    with pytest.raises(QuotaError):
        store.quotas.check("k", 64, lambda: quota)
    with pytest.raises(QuotaError):
        enter(store, entry("b"), quota)
    assert store.meshes.get("b") is None


@pytest.mark.parametrize(
    ("limits", "limit"),
    [(Quota(queued=2, points=0), "key_max_queued"), (Quota(queued=0, points=200, most_points=100), "key_max_points")],
    ids=["meshes", "points"],
)
def test_the_quota_counts_meshes_in_flight(
    store: Store, monkeypatch: pytest.MonkeyPatch, limits: Quota, limit: str
) -> None:
    enter(store, entry("a"))
    waits: list[float] = []
    sleep = lambda seconds: (waits.append(seconds), enter(store, entry("b")))  # noqa: E731
    monkeypatch.setattr(keys, "time", SimpleNamespace(monotonic=time.monotonic, sleep=sleep))
    with pytest.raises(QuotaError) as refused:
        store.quotas.check("k", 100, lambda: replace(limits, in_flight=("a", "b")))
    assert (refused.value.limit, len(waits)) == (limit, 1)  # b was in flight, and then in the store
    store.queue.finish(Claim("b", 1))
    store.quotas.check("k", 100, lambda: replace(limits, in_flight=("a", "b")))
    monkeypatch.setattr(keys, "MAX_FLIGHT_SECONDS", -1.0)
    if limit == "key_max_queued":
        with pytest.raises(QuotaError):
            store.quotas.check("k", 100, lambda: replace(limits, in_flight=("never",)))
    else:
        store.quotas.check("k", 100, lambda: replace(limits, in_flight=("never",)))  # its points are not known


def test_a_mesh_in_flight_that_never_enters_the_store_makes_room(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    flying = [("refused", "reused"), ("reused",)]
    waits: list[float] = []
    monkeypatch.setattr(keys, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=waits.append))
    one = Quota(queued=1, points=0)
    store.quotas.check("k", 100, lambda: replace(one, in_flight=flying.pop(0) if flying else ()))
    assert len(waits) == 2


def test_a_repeated_key_gets_its_mesh_also_at_the_limit(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    enter(store, entry("a", key="x"), quota)
    assert enter(store, entry("b", key="x"), quota) == "a"
