"""Files of meshes are removed with the last mesh that has them."""

from __future__ import annotations

from equimesh_service.store.rows import Artifact, Outcome
from equimesh_service.store.store import Store
from service.store.stores import add, claimed


def test_a_file_goes_with_the_last_mesh_that_has_it(store: Store) -> None:
    shared, own = "1" * 64, "2" * 64
    for mesh_id, files in (("a", [Artifact("mesh", shared, 1), Artifact("quality", own, 1)]), ("b", [])):
        add(store, mesh_id)
        store.queue.finish(claimed(store), Outcome(files=[*files, Artifact("convergence", shared, 1)]))
    removed: list[str] = []
    assert store.meshes.delete("a", removed.append)
    assert removed == [own]
    assert store.meshes.delete("b", removed.append)
    assert removed == [own, shared]
    assert not store.meshes.delete("b", removed.append)
