"""A mesh in parts in a store, whose points come from a formula: no cluster computes it."""

from __future__ import annotations

import secrets
from typing import Any

import numpy as np

import equimesh
from equimesh_cluster.mesh_part import cut
from equimesh_service import Settings
from equimesh_service.files.address import files_address
from equimesh_service.spec.mesh import read_spec
from equimesh_service.store.rows import Artifact, Lease, NewMesh, Outcome
from equimesh_service.store.store import Store
from equimesh_service.worker.in_parts import PartsLayout, write_head_file, write_part_file
from equimesh_service.worker.job import head_name, part_artifact
from equimesh_service.worker.part_formats import WRITTEN

SHAPE = (17, 9)
CUTS = (6, 12)
TRAFFIC = {"bytes": 1024, "messages": 8, "attempts": 1}


def bent_mesh() -> equimesh.Mesh:
    """Its nodes."""
    xi, eta = np.meshgrid(np.linspace(0, 1, SHAPE[0]), np.linspace(0, 1, SHAPE[1]), indexing="ij")
    return equimesh.Mesh(xi + 0.05 * np.sin(np.pi * eta) * np.sin(np.pi * xi), eta**1.5)


def u_of(x: Any, y: Any) -> Any:
    """The values of its u."""
    return np.tanh(5.0 * (x - y))


def store_in_parts(settings: Settings, key_id: str = "") -> str:
    """The id of a new mesh in parts in the store of a service with these settings."""
    store, files = Store(settings.database), files_address(settings).open()
    document = {
        "monitor": {"kind": "curvature", "u": "tanh(5*(x-y))"},
        "grid": {"n_xi": SHAPE[0], "n_eta": SHAPE[1]},
        "parts": 3,
    }
    new = NewMesh(id=f"m-{secrets.token_hex(10)}", spec=read_spec(document).canonical, key_id=key_id)
    layout = PartsLayout(
        name=new.id, grid=equimesh.Grid(n_xi=SHAPE[0], n_eta=SHAPE[1]), firsts=(0, *CUTS), nodes=("u",)
    )
    artifacts = []
    for part in cut(bent_mesh(), CUTS):
        with files.unfinished(".vtu") as path:
            write_part_file(path, part, {"u": u_of}, WRITTEN)
            file = files.seal(path)
            files.publish(path, file, lambda _: False)
        artifacts.append(Artifact(part_artifact(WRITTEN, part.number), file.sha256, file.size))
    with files.unfinished(".pvtu") as path:
        write_head_file(path, layout, WRITTEN)
        file = files.seal(path)
        files.publish(path, file, lambda _: False)
    artifacts.append(Artifact(head_name(WRITTEN), file.sha256, file.size))
    try:
        assert store.meshes.add(new, lease=Lease(owner="test", seconds=60.0)) == new.id
        result = {"parts": {**layout.record(), "traffic": TRAFFIC}, "quality": {"min_jacobian": 0.5}}
        claim = store.queue.renew("test", 60.0).pop()
        assert store.queue.finish(claim, Outcome(result=result, files=artifacts))
    finally:
        store.close()
    return new.id
