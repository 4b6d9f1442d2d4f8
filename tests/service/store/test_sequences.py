"""Sequences in the store: one step after the other."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import pytest

from equimesh_service.errors import StepTakenError
from equimesh_service.store.rows import Artifact, NewMesh, NewStep, Outcome, SamplesRow
from equimesh_service.store.store import Store
from service.requests import FRONT
from service.store.stores import claimed


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
    assert sequence is not None
    assert (sequence.number, sequence.mesh_id, sequence.status) == (0, first, "succeeded")
    second = steps.take(1)  # in place of the one that failed
    with pytest.raises(StepTakenError):
        steps.take(1)
    order = store.meshes.get_input(second)
    assert order is not None
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
