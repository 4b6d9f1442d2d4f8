"""Stores that tests fill: a spec, a problem, a time that a test moves, and rows that are added and claimed."""

from __future__ import annotations

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


def claimed(store: Store, owner: str = "me") -> Claim:
    claim = store.queue.claim(owner, 10.0)
    assert claim is not None
    return claim


def status(store: Store, mesh_id: str) -> str:
    row = store.meshes.get(mesh_id)
    assert row is not None
    return row.status
