"""Stores that tests fill: a spec, a problem, a time that a test moves, and rows that are added and claimed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from equimesh_service.store.mesh_rows import insert_waiting
from equimesh_service.store.rows import Claim, NewMesh
from equimesh_service.store.store import Store

SPEC = {"label": None, "grid": {"n_xi": 8, "n_eta": 8}, "cells": "quad"}
ERROR = {"type": "/problems/worker-lost"}


class Clock:
    """A time that the test moves."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


def add(store: Store, mesh_id: str, **more: object) -> str:
    return store.meshes.add(NewMesh(id=mesh_id, spec={**SPEC, **more}))


def add_backlog(store: Store, number: int, key_id: str, spec: Mapping[str, Any] = SPEC) -> None:
    """Put this many meshes of a key into the queue, in one transaction."""
    with store.database.write(durable=False) as connection:
        for name in range(number):
            insert_waiting(connection, NewMesh(id=f"{key_id}-{name}", spec=spec, key_id=key_id), None, time.time())


def claimed(store: Store, owner: str = "me", key_id: str = "") -> Claim:
    claim = store.queue.claim(owner, 10.0, key_id)
    assert claim is not None
    return claim


def status(store: Store, mesh_id: str) -> str:
    row = store.meshes.get(mesh_id)
    return row.status
