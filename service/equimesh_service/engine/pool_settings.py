"""The settings of the pools of processes that the workers of a cluster open for a service."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from equimesh_service.engine.packed_call import PackedCall


@dataclass(frozen=True, kw_only=True)
class PoolSettings:
    """The settings of the pools of a service's workers, as of :class:`~equimesh_service.engine.pebble.PebbleEngine`.

    ``check`` returns what a worker cannot reach, "" where it reaches everything. It is called in a process of the pool.
    """

    memory_limit: int | None = None
    preload: tuple[str, ...] = ()
    warm_up: PackedCall | None = None
    prepare: PackedCall | None = None
    check: PackedCall | None = None

    @property
    def name(self) -> str:
        """The name of the pool on each worker: services with the same settings share it."""
        return f"equimesh-{hashlib.sha256(repr(self).encode()).hexdigest()[:16]}"
