"""Samples stay while a mesh or a key needs them."""

from __future__ import annotations

import pytest

from equimesh_service.errors import SamplesGoneError
from equimesh_service.store.rows import NewMesh, SamplesRow
from equimesh_service.store.store import Store
from service.store.stores import SPEC


def test_samples_that_a_waiting_mesh_needs_stay(store: Store) -> None:
    row = SamplesRow("s-1", "3" * 64, 10, {"kind": "grid"}, 1.0)
    assert store.samples.add(row)
    assert not store.samples.add(row)
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1",)))
    removed: list[str] = []
    assert store.samples.delete("s-1", removed.append) is False
    store.queue.cancel("a")
    assert store.samples.delete("s-1", removed.append) is True
    assert removed == ["3" * 64]
    assert store.samples.delete("s-1", removed.append) is None
    with pytest.raises(SamplesGoneError):
        store.meshes.add(NewMesh(id="b", spec=SPEC, samples=("s-1",)))


def test_every_sample_of_a_mesh_is_kept_until_it_is_finished(store: Store) -> None:
    for name in ("s-1", "s-2"):
        store.samples.add(SamplesRow(name, name, 1, {}, 0.0))
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1", "s-2")))
    gone: list[str] = []
    assert [store.samples.delete(name, gone.append) for name in ("s-1", "s-2")] == [False] * 2
    store.queue.cancel("a")
    assert store.samples.delete("s-2", gone.append) is True
    assert store.meshes.delete("a", gone.append)
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["s-2", "s-1"]


def test_samples_of_two_keys_are_stored_once_and_are_each_ones_own(store: Store) -> None:
    row, later = SamplesRow("s-1", "3" * 64, 10, {}, 1.0), SamplesRow("s-1", "3" * 64, 10, {}, 2.0)
    published: list[str] = []
    assert store.samples.add(row, lambda _: published.append("a"), key_id="a")
    assert store.samples.get("s-1", "b") is None
    assert store.samples.add(later, lambda _: published.append("b"), key_id="b")
    assert published == ["a"]
    assert (store.samples.get("s-1", "a"), store.samples.get("s-1", "b")) == (row, later)
    assert store.samples.get("s-1") == row
    gone: list[str] = []
    store.meshes.add(NewMesh(id="m", spec=SPEC, samples=("s-1",), key_id="a"))
    assert store.samples.delete("s-1", gone.append, "c") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    assert store.samples.delete("s-1", gone.append, "b") is True
    assert store.samples.get("s-1", "b") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    store.queue.cancel("m")
    assert gone == []
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["3" * 64]
