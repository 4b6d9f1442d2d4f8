"""A database as the first release left it."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

from sqlalchemy import Engine, insert

FIRST = import_module("equimesh_service.store.migrations.versions.r0001_first_release").tables()
SPEC = {
    "monitor": {"kind": "arc_length", "u": {"expression": "x*y", "parameters": {}, "t": 0.0}, "a": 0.7, "b": 0.05},
    "domain": {"kind": "rectangle", "x": [0.0, 1.0], "y": [0.0, 1.0]},
    "grid": {"n_xi": 8, "n_eta": 8},
    "boundary": "trace",
    "initial": "nested",
    "schwarz": None,
    "cells": "quad",
    "label": "von früher",
}
MESH = {
    "spec": json.dumps(SPEC, ensure_ascii=False),
    "label": "old",
    "n_xi": 8,
    "n_eta": 8,
    "cells": "quad",
    "created_at": 1.0,
    "attempt": 1,
    "losses": 0,
    "last_event": 1,
    "partial": False,
}


def fill(engine: Engine, sha256: str, size: int) -> None:
    """A database as release 0.1 left it: a finished mesh with a file, one that waits, samples, a key."""
    FIRST.create_all(engine)
    rows: dict[str, list[dict[str, Any]]] = {
        "meshes": [
            {**MESH, "id": "m-1", "status": "succeeded", "finished_at": 2.0, "result": {"quality": None}},
            {**MESH, "id": "m-2", "status": "queued", "samples_id": "s-1"},
        ],
        "events": [
            {"mesh_id": name, "number": 1, "time": 1.0, "kind": "status", "data": {"status": "queued"}}
            for name in ("m-1", "m-2")
        ],
        "artifacts": [{"mesh_id": "m-1", "name": "mesh", "sha256": sha256, "size": size}],
        "samples": [{"id": "s-1", "sha256": "5" * 64, "size": 7, "summary": {"kind": "grid"}, "created_at": 3.0}],
        "idempotency": [{"key": "k", "fingerprint": "f", "mesh_id": "m-1"}],
    }
    with engine.begin() as connection:
        for name, members in rows.items():
            for row in members:
                connection.execute(insert(FIRST.tables[name]).values(row))
