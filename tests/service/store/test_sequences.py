"""Sequences in the store: one step after the other."""

from __future__ import annotations

import time
from typing import Any

import pytest

from equimesh_service.errors import StepTakenError
from equimesh_service.store.rows import Artifact, NewMesh, NewStep, SamplesRow
from equimesh_service.store.store import Store
from service.requests import FRONT


def test_the_store_takes_one_step_after_the_other(database_url: str) -> None:
    store, removed = Store(database_url), list[str]()
    store.prepare()

    def take(number: int) -> str:
        name = f"m-{number}-{time.monotonic_ns()}"
        nodal = SamplesRow(f"n-{number}", f"{number}" * 64, 1, {"kind": "nodal"}, 0.0)
        store.samples.add(nodal)
        new = NewMesh(id=name, spec={**FRONT, "cells": "quad", "label": None}, samples=(nodal.id,))
        fields = Artifact("fields", f"f{number}" * 32, 1)
        step = NewStep(
            sequence_id="q-1",
            number=number,
            keep=2,
            fingerprint="",
            start="a" * 64,
            fields=fields,
            discard=removed.append,
        )
        store.meshes.add(new, step=step)
        return name

    def finish(name: str, error: dict[str, Any] | None = None) -> None:
        claim = store.queue.claim("me", 9.0)
        assert claim is not None
        assert (claim.mesh_id, store.queue.finish(claim, error=error)) == (name, True)

    first = take(0)
    with pytest.raises(StepTakenError):
        take(1)  # it is not finished
    finish(first)
    finish(take(1), error={"type": "/problems/folded"})
    sequence = store.sequences.get("q-1")
    assert sequence is not None
    assert (sequence.number, sequence.mesh_id, sequence.status) == (0, first, "succeeded")
    second = take(1)  # in place of the one that failed
    with pytest.raises(StepTakenError):
        take(1)
    order = store.meshes.get_input(second)
    assert order is not None
    assert (order.start, order.fields, list(order.samples)) == ("a" * 64, "f1" * 32, ["n-1"])
    finish(second)
    assert removed == []
    finish(take(2))
    assert store.meshes.get(first) is None  # two are kept
    assert set(removed) == {"0" * 64, "f0" * 32}
    assert store.samples.get("n-0") is None
    assert store.meshes.delete(str(store.sequences.mesh_of("q-1", 2)), removed.append)
    assert store.sequences.step_of(second) == ("q-1", 1)
    assert store.sequences.delete("q-1", removed.append)
    assert (store.sequences.get("q-1"), store.sequences.meshes("q-1"), store.meshes.get(second)) == (None, [], None)
    assert not store.sequences.delete("q-1", removed.append)
    store.close()
