"""The mesh of an attempt in the store: entered at the first report of progress, and not before."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from equimesh_service.errors import KeyTakenError
from equimesh_service.store.rows import Artifact, Claim, Lease, NewEntry, NewMesh, Outcome
from equimesh_service.store.store import Store
from equimesh_service.worker.solve import Attempt
from service.store.stores import SPEC, add, claimed, status


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    return store


def new(store: Store, mesh_id: str = "a", key: str | None = None) -> Attempt:
    entry = NewEntry(new=NewMesh(id=mesh_id, spec=SPEC), key=key, fingerprint="f")
    return Attempt(store, Claim(mesh_id, 1), entry, Lease(owner="me", seconds=10.0))


def test_a_new_mesh_enters_with_its_first_progress(store: Store) -> None:
    attempt = new(store)
    assert store.meshes.get("a") is None
    assert attempt.report({"stage": "start"})
    assert (status(store, "a"), attempt.entry) == ("running", None)
    assert attempt.report({"stage": "writing"})
    assert attempt.keep(Outcome(result={}), 1.0)
    assert status(store, "a") == "succeeded"
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "progress", "progress", "done"]


def test_a_mesh_that_has_just_begun_is_not_entered(store: Store) -> None:
    attempt = new(store)
    attempt.began = time.perf_counter() + 3600.0
    attempt.enter_if_late()
    assert attempt.report({})
    assert store.meshes.get("a") is None
    attempt.began = float("-inf")
    attempt.enter_if_late()
    assert status(store, "a") == "running"


def test_without_progress_it_enters_finished(store: Store) -> None:
    assert new(store).keep(Outcome(result={}, files=[Artifact("mesh", "0" * 64, 1)]), 1.0)
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "done"]


def test_an_entered_mesh_that_is_canceled_or_deleted_is_lost(store: Store) -> None:
    attempt = new(store)
    attempt.report({})
    assert store.queue.cancel("a")
    assert not attempt.report({})
    store.meshes.delete("a", lambda _: None)
    assert not attempt.report({})  # and it does not come back
    assert not attempt.keep(Outcome(result={}), 1.0)
    assert store.meshes.get("a") is None


@pytest.mark.parametrize("finished", [False, True])
def test_a_key_that_another_mesh_has_ends_the_attempt(store: Store, finished: bool) -> None:
    new(store, "first", key="x").report({})
    attempt = new(store, "second", key="x")
    with pytest.raises(KeyTakenError) as caught:
        _ = attempt.keep(Outcome(result={}), 1.0) if finished else attempt.report({})
    assert caught.value.mesh_id == "first"
    assert store.meshes.get("second") is None


def test_a_mesh_of_the_queue_is_there_from_the_beginning(store: Store) -> None:
    add(store, "a")
    attempt = Attempt(store, claimed(store))
    assert attempt.report({})
    assert attempt.keep(Outcome(result={}), 1.0)
    assert not attempt.report({})
