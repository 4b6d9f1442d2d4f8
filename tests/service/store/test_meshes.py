"""Meshes and sequences in the store: events, idempotency keys, lists, results that are reused, one step at a time."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import pytest

from equimesh_service.api.routing import cursor_of, position_of
from equimesh_service.errors import KeyReusedError, StepTakenError
from equimesh_service.spec.mesh import read_spec
from equimesh_service.store.rows import Artifact, NewMesh, NewStep, Outcome, SamplesRow
from equimesh_service.store.store import Store
from service.requests import FRONT
from service.store.first_release import SPEC as FIRST_SPEC
from service.store.stores import ERROR, SPEC, Clock, add, claimed


def test_events_are_numbered_without_gaps_and_tell_the_story(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)
    assert store.queue.progress(claim, {"fraction": 0.5})
    assert store.queue.finish(claim, Outcome(result={"quality": None}))
    events = store.meshes.events("a")
    assert [event.number for event in events] == [1, 2, 3, 4]
    assert [event.kind for event in events] == ["status", "status", "progress", "done"]
    assert [event.number for event in store.meshes.events("a", after=2)] == [3, 4]


def test_the_same_key_gives_the_same_mesh(store: Store) -> None:
    first = store.meshes.add(NewMesh(id="a", spec=SPEC), key="k", fingerprint="f")
    again = store.meshes.add(NewMesh(id="b", spec=SPEC), key="k", fingerprint="f")
    assert (first, again) == ("a", "a")
    assert store.meshes.get("b") is None
    with pytest.raises(KeyReusedError):
        store.meshes.add(NewMesh(id="c", spec=SPEC), key="k", fingerprint="other")
    store.meshes.delete("a", lambda _: None)
    assert store.meshes.add(NewMesh(id="d", spec=SPEC), key="k", fingerprint="f") == "d"


def test_list_filters_and_pages(store: Store) -> None:
    for number in range(5):
        add(store, f"m{number}", label="odd" if number % 2 else "even")
    assert [row.id for row in store.meshes.page(limit=2)] == ["m4", "m3"]
    assert [row.id for row in store.meshes.page(before=(store.meshes.page(limit=2)[-1].number,))] == ["m2", "m1", "m0"]
    assert [row.id for row in store.meshes.page(label="odd")] == ["m3", "m1"]
    store.queue.cancel("m0")
    assert [row.id for row in store.meshes.page(status="canceled")] == ["m0"]


def test_a_spec_of_the_first_release_is_read(store: Store) -> None:
    store.meshes.add(NewMesh(id="a", spec=FIRST_SPEC))
    checked = read_spec(store.meshes.spec("a"))
    spec, canonical = checked.spec, checked.canonical
    assert (spec.mode, spec.allow_relaxed, spec.monitor.smoothing) == ("discretization", True, 0.0)
    domain = {**FIRST_SPEC["domain"], "periodic": None}
    expected = {**FIRST_SPEC, "monitor": canonical["monitor"], "domain": domain}
    assert {key: canonical[key] for key in FIRST_SPEC} == expected


def test_each_key_has_its_own_list_and_its_own_idempotency_keys(store: Store) -> None:
    for owner in ("a", "b"):
        new = NewMesh(id=f"of-{owner}", spec=SPEC, key_id=owner)
        assert store.meshes.add(new, key="k", fingerprint=owner) == new.id
    assert [row.id for row in store.meshes.page(key_id="a")] == ["of-a"]
    assert [row.id for row in store.meshes.page()] == ["of-b", "of-a"]


@pytest.mark.parametrize("key_id", [None, ""], ids=["all", "own"])
def test_a_page_neither_leaves_out_nor_repeats_while_meshes_come_and_go(
    store: Store, clock: Clock, key_id: str | None
) -> None:
    for number in range(12):
        add(store, f"m{number}")
        clock.now += number % 2  # some are made at the same moment
    seen: list[str] = []
    cursor, came = None, 0
    while page := store.meshes.page(
        key_id=key_id, before=None if cursor is None else position_of(cursor, key_id), limit=3
    ):
        seen += [row.id for row in page]
        cursor = cursor_of(page[-1], key_id)
        clock.now += 0.001
        add(store, f"new{came}")
        store.meshes.delete(seen[-1], lambda _: None)  # the very row that the next page begins after
        store.meshes.delete(f"m{came}", lambda _: None)  # from the other end
        came += 1
    kept = [name for number in range(12) if store.meshes.get(name := f"m{number}")]
    assert len(seen) == len(set(seen))
    left = [name for name in seen if store.meshes.get(name)]
    assert (left[::-1] if key_id is None else sorted(left, key=kept.index)) == kept
    assert not any(name.startswith("new") for name in seen)


def test_ids_that_no_database_takes_are_not_there(store: Store) -> None:
    assert store.meshes.get("m\x00") is None
    assert not store.queue.cancel("m\x00")
    assert not store.meshes.delete("m\x00", lambda _: None)
    assert store.samples.get("s\x00", "") is None


def succeeded(store: Store, mesh_id: str, fingerprint: str = "f", key_id: str = "") -> None:
    store.meshes.add(NewMesh(id=mesh_id, spec=SPEC, fingerprint=fingerprint, key_id=key_id))
    result = {"quality": {"min_jacobian": 1.0}, "timings": {"solve": 2.0}}
    files = [Artifact("mesh", "4" * 64, 9), Artifact("file:vtu:quad", "5" * 64, 8)]
    assert store.queue.finish(claimed(store, key_id=key_id), Outcome(result=result, files=files))


def again(store: Store, mesh_id: str = "again", fingerprint: str | None = "f", **more: Any) -> str | None:
    return store.meshes.reuse(NewMesh(id=mesh_id, spec={**SPEC, "label": "new"}, fingerprint=fingerprint, **more))


def test_a_mesh_that_has_succeeded_is_handed_on(store: Store) -> None:
    assert again(store) is None
    succeeded(store, "first")
    assert again(store) == "again"
    row = store.meshes.get("again")
    assert (row.status, row.label, row.reused_from, row.attempt) == ("succeeded", "new", "first", 0)
    assert row.result == {"quality": {"min_jacobian": 1.0}}  # how long it took is not a matter of this one
    assert [(event.kind, event.data["reused_from"]) for event in store.meshes.events("again")] == [("done", "first")]
    gone: list[str] = []
    assert store.meshes.delete("first", gone.append)
    assert gone == []
    assert store.meshes.artifact("again", "file:vtu:quad") == Artifact("file:vtu:quad", "5" * 64, 8)
    assert again(store, "third") == "third"  # of the second, now that the first is gone
    assert store.meshes.delete("again", gone.append)
    assert store.meshes.delete("third", gone.append)
    assert sorted(gone) == ["4" * 64, "5" * 64]


def test_only_what_has_succeeded_for_the_same_key_is_handed_on(store: Store) -> None:
    succeeded(store, "other", key_id="other")
    store.meshes.add(NewMesh(id="failed", spec=SPEC, fingerprint="f"))
    store.queue.finish(claimed(store), Outcome(error=ERROR))
    store.meshes.add(NewMesh(id="canceled", spec=SPEC, fingerprint="f"))
    store.queue.cancel("canceled")
    store.meshes.add(NewMesh(id="waits", spec=SPEC, fingerprint="f"))
    assert again(store) is None
    assert again(store, fingerprint=None) is None
    assert again(store, key_id="other") == "again"


def test_handing_on_heeds_the_idempotency_key(store: Store) -> None:
    succeeded(store, "first")
    new = [NewMesh(id=f"m{number}", spec=SPEC, fingerprint="f") for number in range(3)]
    assert [store.meshes.reuse(mesh, key="k", fingerprint="x") for mesh in new] == ["m0"] * 3
    with pytest.raises(KeyReusedError):
        store.meshes.reuse(new[1], key="k", fingerprint="other")


def test_handing_on_while_the_first_is_deleted_never_leaves_a_mesh_without_files(store: Store) -> None:
    removed: list[str] = []
    for _ in range(5):
        succeeded(store, "first")
        barrier = threading.Barrier(2)

        def delete(barrier: threading.Barrier = barrier) -> None:
            barrier.wait()
            store.meshes.delete("first", removed.append)

        thread = threading.Thread(target=delete)
        thread.start()
        barrier.wait()
        handed_on = again(store) is not None
        thread.join()
        assert (store.meshes.artifact("again", "mesh") is not None) == handed_on
        assert ("4" * 64 in removed) != handed_on
        store.meshes.delete("again", removed.append)
        removed.clear()


@dataclass
class Steps:
    """The steps of one sequence, which keeps two, and the files of their meshes."""

    store: Store
    name: str = "q-1"
    key_id: str = ""
    removed: list[str] = field(default_factory=list)

    def take(self, number: int) -> str:
        """The mesh of a step that is taken."""
        name = f"m-{number}-{time.monotonic_ns()}"
        nodal = SamplesRow(f"n-{number}", f"{number}" * 64, 1, {"kind": "nodal"}, 0.0)
        self.store.samples.add(nodal)
        new = NewMesh(id=name, spec={**FRONT, "cells": "quad", "label": None}, samples=(nodal.id,))
        step = NewStep(
            sequence_id=self.name,
            key_id=self.key_id,
            number=number,
            keep=2,
            fingerprint="",
            start="a" * 64,
            fields=Artifact("fields", f"f{number}" * 32, 1),
            discard=self.removed.append,
        )
        self.store.meshes.add(new, step=step)
        return name

    def finish(self, name: str, error: dict[str, Any] | None = None) -> str:
        """The mesh, which a worker has finished."""
        claim = claimed(self.store)
        assert (claim.mesh_id, self.store.queue.finish(claim, Outcome(error=error))) == (name, True)
        return name


def test_one_step_is_taken_after_the_other(store: Store) -> None:
    steps = Steps(store)
    first = steps.take(0)
    with pytest.raises(StepTakenError):
        steps.take(1)  # it is not finished
    steps.finish(first)
    steps.finish(steps.take(1), error={"type": "/problems/folded"})
    sequence = store.sequences.get("q-1")
    assert (sequence.number, sequence.mesh_id, sequence.status) == (0, first, "succeeded")
    second = steps.take(1)  # in place of the one that failed
    with pytest.raises(StepTakenError):
        steps.take(1)
    order = store.meshes.get_input(second)
    assert (order.start, order.fields, list(order.samples)) == ("a" * 64, "f1" * 32, ["n-1"])


def test_sequences_are_listed_newest_first_at_their_last_good_step(store: Store) -> None:
    names = {"q-1": "a", "q-2": "", "q-3": "a"}
    for name, key_id in names.items():
        steps = Steps(store, name=name, key_id=key_id)
        steps.finish(steps.take(0))
    steps.finish(steps.take(1))
    steps.finish(steps.take(2), error={"type": "/problems/folded"})
    found = store.sequences.page()
    assert [(row.id, row.number, row.status) for row in found] == [
        ("q-3", 1, "succeeded"),
        ("q-2", 0, "succeeded"),
        ("q-1", 0, "succeeded"),
    ]
    assert found == [store.sequences.get(row.id) for row in found]
    assert [row.id for row in store.sequences.page(key_id="a")] == ["q-3", "q-1"]
    first = store.sequences.page(limit=1)[0]
    assert [row.id for row in store.sequences.page(before=(first.created_at, first.id))] == ["q-2", "q-1"]
    meshes = store.meshes.several([*(row.mesh_id for row in found), "m-none"])
    assert sorted(meshes) == sorted(row.mesh_id for row in found)
    store.sequences.delete("q-2", lambda _: None)
    assert [row.id for row in store.sequences.page()] == ["q-3", "q-1"]


def test_a_sequence_keeps_its_last_steps_and_is_deleted_whole(store: Store) -> None:
    steps = Steps(store)
    first, second = (steps.finish(steps.take(number)) for number in range(2))
    assert steps.removed == []
    steps.finish(steps.take(2))
    assert store.meshes.get(first) is None  # two are kept
    assert set(steps.removed) == {"0" * 64, "f0" * 32}
    assert store.samples.get("n-0") is None
    assert store.meshes.delete(str(store.sequences.mesh_of("q-1", 2)), steps.removed.append)
    assert store.sequences.step_of(second) == ("q-1", 1)
    assert store.sequences.delete("q-1", steps.removed.append)
    assert (store.sequences.get("q-1"), store.sequences.meshes("q-1"), store.meshes.get(second)) == (None, [], None)
    assert not store.sequences.delete("q-1", steps.removed.append)
