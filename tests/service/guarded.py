"""A service with API keys, for tests of scopes, limits and ownership."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from equimesh_service import Settings, running
from equimesh_service.store.keys import KeyRow
from equimesh_service.store.store import Store


@dataclass(frozen=True)
class Guarded:
    """The address of a service, its settings, and its store, in which keys are created."""

    url: str
    settings: Settings
    store: Store

    def key(self, *scopes: str) -> tuple[KeyRow, str]:
        """A new key and its secret."""
        return self.store.keys.create("test", scopes)

    def client(self, *scopes: str) -> httpx.Client:
        """A client with a new key, or without one when there are no scopes."""
        return self.having(self.key(*scopes)[1] if scopes else None)

    def having(self, secret: str | None) -> httpx.Client:
        """A client with this secret."""
        headers = {} if secret is None else {"Authorization": f"Bearer {secret}"}
        return httpx.Client(base_url=self.url, headers=headers, timeout=600.0)


@contextmanager
def guarded(folder: Path, **changes: object) -> Iterator[Guarded]:
    """A service whose first key was created before its start."""
    settings = Settings(
        data_dir=folder / "data",
        port=0,
        workers=1,
        max_points=20_000,
        max_body=200_000,
        key_max_queued=3,
        key_max_points=1000,
        key_max_bytes=200_000,
        key_requests_per_minute=600,
        key_max_waits=3,
        log_level="warning",
        **changes,  # type: ignore[arg-type]
    )
    settings.data_dir.mkdir()
    store = Store(settings.database)
    store.prepare()
    store.keys.create("the first", ["admin"])
    try:
        with running(settings) as url:
            yield Guarded(url, settings, store)
    finally:
        store.close()
