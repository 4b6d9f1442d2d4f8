"""An empty store on each database, whose time a test moves."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from equimesh_service.store.schema import metadata
from equimesh_service.store.store import Store
from service.databases import database
from service.store.stores import Clock


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with database(request.param, tmp_path_factory.mktemp("store"), request) as url:
        yield url


@pytest.fixture
def store(address: str, clock: Clock) -> Iterator[Store]:
    store = Store(address, clock=clock)
    store.prepare()
    yield store
    with store.database.write() as connection:  # much faster than new tables
        for table in reversed(metadata.sorted_tables):
            connection.execute(table.delete())
    store.close()
