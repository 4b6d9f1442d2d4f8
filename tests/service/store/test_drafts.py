"""Drafts: meshes that are finished before the store knows of them, and those that are entered while they run."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import pytest

from equimesh_service.errors import KeyReusedError, QuotaError
from equimesh_service.files.port import Removed
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Artifact, Claim, Draft, Lease, NewMesh, NewSamples, Outcome, SamplesRow
from equimesh_service.store.store import Store
from service.store.stores import ERROR, SPEC, Clock, claimed, status

LEASE = Lease(owner="me", seconds=10.0)
SENT = NewSamples(SamplesRow("s-1", "5" * 64, 3, {"kind": "grid"}, 1000.0), b"npz")
FILE = Artifact("mesh", "0" * 64, 1)


def draft(mesh_id: str = "a", *, samples: NewSamples | None = None, key: str | None = None) -> Draft:
    names = () if samples is None else (samples.row.id,)
    new = NewMesh(id=mesh_id, spec=SPEC, samples=names, fingerprint=mesh_id, key_id="k")
    return Draft(new=new, built=None, samples=samples, key=key, fingerprint="f")


def finish(store: Store, made: Draft, outcome: Outcome | None = None, published: list[str] | None = None) -> str | None:
    published = [] if published is None else published

    def publish(name: str) -> Any:
        def note(_: Removed) -> None:
            published.append(name)

        return note

    outcome = replace(outcome or Outcome(result={}, files=[FILE]), publish=publish("mesh"))
    claim = Claim(made.new.id, 1)
    return store.drafts.finish(made, claim, outcome, seconds=2.0, publish_samples=publish("samples"))


def test_a_finished_draft_is_a_mesh_with_its_samples_files_and_story(store: Store) -> None:
    published: list[str] = []
    assert finish(store, draft(samples=SENT), published=published) == "a"
    row = store.meshes.get("a")
    assert row is not None
    assert (row.status, row.attempt, row.created_at, row.finished_at) == ("succeeded", 1, 998.0, 1000.0)
    assert store.meshes.artifact("a", "mesh") == FILE
    assert store.samples.get("s-1", "k") == SENT.row
    assert [event.data["status"] for event in store.meshes.events("a")] == ["queued", "running", "succeeded"]
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]
    assert published == ["samples", "mesh"]
    assert store.queue.claim("me", 10.0, "k") is None


def test_a_draft_may_fail(store: Store) -> None:
    assert finish(store, draft(), Outcome(error=ERROR, partial=True)) == "a"
    row = store.meshes.get("a")
    assert row is not None
    assert (row.status, row.error, row.partial) == ("failed", ERROR, True)
    assert store.meshes.events("a")[-1].data == {"status": "failed", "error": ERROR}


def test_a_draft_that_is_entered_runs_and_its_worker_ends_it(store: Store) -> None:
    assert not store.drafts.exists("a")
    assert store.drafts.enter(draft(), LEASE, None) == "a"
    assert store.drafts.exists("a")
    assert status(store, "a") == "running"
    assert store.queue.find_held("me") == {Claim("a", 1)}
    assert finish(store, draft()) == "a"
    assert status(store, "a") == "succeeded"
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "done"]
    assert store.drafts.enter(draft(), LEASE, None) == "a"  # too late: it is there
    assert status(store, "a") == "succeeded"


def test_an_entered_draft_that_is_canceled_has_no_outcome(store: Store) -> None:
    store.drafts.enter(draft(), LEASE, None)
    assert store.queue.cancel("a")
    published: list[str] = []
    assert finish(store, draft(), published=published) is None
    assert (status(store, "a"), published) == ("canceled", [])


def test_an_entered_draft_that_is_deleted_does_not_come_back(store: Store) -> None:
    made = draft()
    store.drafts.enter(made, LEASE, None)
    store.queue.cancel("a")
    store.meshes.delete("a", lambda _: None)
    claim, outcome = Claim("a", 1), Outcome(result={})
    more: Any = {"seconds": 1.0, "publish_samples": lambda _: None, "entered": True}
    assert store.drafts.finish(made, claim, outcome, **more) is None
    assert not store.drafts.exists("a")


def test_an_entered_draft_whose_service_is_silent_is_taken_over(store: Store, clock: Clock) -> None:
    store.drafts.enter(draft(), LEASE, None)
    clock.now += 11.0
    assert store.queue.find_abandoned() == [Claim("a", 1)]
    assert store.queue.lose(Claim("a", 1), "silent", most=3, error=ERROR) == "queued"
    assert finish(store, draft()) is None  # the first attempt is over
    assert claimed(store, "other", "k") == Claim("a", 2)


@pytest.mark.parametrize("entered", [False, True])
def test_the_same_key_gives_the_same_mesh(store: Store, entered: bool) -> None:
    first, second = draft("a", key="x"), draft("b", key="x")
    assert store.drafts.enter(first, LEASE, None) == "a" if entered else finish(store, first) == "a"
    assert finish(store, second) == "a"
    assert store.drafts.enter(second, LEASE, None) == "a"
    assert store.meshes.get("b") is None
    with pytest.raises(KeyReusedError):
        finish(store, replace(second, fingerprint="other"))


def test_whoever_comes_first_there_is_one_mesh(store: Store) -> None:
    barrier, found = threading.Barrier(4), []

    def run(do: Any) -> None:
        barrier.wait()
        found.append(do())

    made = draft(samples=SENT, key="x")
    store.samples.add(SENT.row, key_id="k")
    acts = [lambda: finish(store, made), lambda: store.drafts.enter(made, LEASE, None)] * 2
    threads = [threading.Thread(target=run, args=(act,)) for act in acts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found.count("a") >= 3  # of two that finish the same attempt, the second may come too late
    assert status(store, "a") == "succeeded"
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]


def test_the_quota_holds_for_drafts_that_are_entered(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    store.quotas.check("k", 64, quota)
    store.drafts.enter(draft("a"), LEASE, quota)
    with pytest.raises(QuotaError):
        store.quotas.check("k", 64, quota)
    with pytest.raises(QuotaError):
        store.drafts.enter(draft("b"), LEASE, quota)
    assert not store.drafts.exists("b")


def test_a_repeated_key_gets_its_mesh_also_at_the_limit(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    store.drafts.enter(draft("a", key="x"), LEASE, quota)
    assert store.drafts.enter(draft("b", key="x"), LEASE, quota) == "a"
