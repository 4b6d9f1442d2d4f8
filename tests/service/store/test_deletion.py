"""Deletions and steps that meet on PostgreSQL: locks in one order."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
from sqlalchemy import Connection, Table, delete, select, text

from equimesh_service.store.rows import NewMesh, NewStep, Outcome, SamplesRow
from equimesh_service.store.schema import meshes, samples, samples_keys, sequences
from equimesh_service.store.store import Store
from service.conftest import until
from service.databases import Postgres
from service.store.stores import SPEC


@pytest.fixture
def store(postgres: Postgres) -> Iterator[Store]:
    with postgres.database() as url:
        store = Store(url)
        store.prepare()
        yield store
        store.close()


def take(store: Store, number: int, *, failed: bool = False, name: str = "") -> str:
    """A finished step of the only sequence; the samples that it uses are there."""
    name = name or f"m-{number}{failed}"
    store.samples.add(SamplesRow("n-1", "1" * 64, 1, {"kind": "nodal"}, 0.0))
    step = NewStep(sequence_id="q-1", number=number, keep=2, fingerprint="")
    store.meshes.add(NewMesh(id=name, spec=SPEC, samples=("n-1",) if number else ()), step=step)
    claim = store.queue.claim("me", 9.0)
    assert claim is not None
    assert store.queue.finish(claim, Outcome(result={}, error={"type": "/problems/folded"} if failed else None))
    return name


def beside(act: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    return thread


def hold(connection: Connection, table: Table, *, nowait: bool = False) -> None:
    """Lock all rows of a table; with ``nowait`` raise where another transaction has one."""
    connection.execute(select(table.c.id).with_for_update(nowait=nowait))


def keeps_somebody_waiting(connection: Connection) -> bool:
    query = "SELECT 1 FROM pg_locks WHERE NOT granted AND pg_backend_pid() = ANY(pg_blocking_pids(pid))"
    return connection.execute(text(query)).first() is not None


def test_the_last_mesh_of_a_sequence_goes_while_the_sequence_is_locked(store: Store) -> None:
    name = take(store, 0)
    with store.database.write() as connection:
        hold(connection, sequences)  # as its own deletion begins, which asks for the mesh next
        thread = beside(lambda: store.meshes.delete(name, lambda _: None))
        until(lambda: store.meshes.get(name) is None)
        hold(connection, meshes, nowait=True)
    thread.join(300.0)
    with store.database.read() as connection:
        assert connection.execute(select(sequences.c.id)).first() is None


def test_a_step_that_waits_for_its_sequence_holds_nothing(store: Store) -> None:
    take(store, 0)
    take(store, 1, failed=True)
    with store.database.write() as connection:
        hold(connection, sequences)
        thread = beside(lambda: take(store, 1, name="again"))  # with the samples of the one that failed
        until(lambda: keeps_somebody_waiting(connection))
        hold(connection, meshes, nowait=True)
        hold(connection, samples, nowait=True)
    thread.join(300.0)
    row = store.meshes.get("again")
    assert (row.status, store.meshes.get("m-1True")) == ("succeeded", None)
    assert store.samples.get("n-1") is not None


def test_samples_that_are_deleted_while_they_come_again_are_there(store: Store) -> None:
    row, published = SamplesRow("s-1", "1" * 64, 1, {}, 0.0), list[str]()
    store.samples.add(row, key_id="a")
    with store.database.write() as connection:
        hold(connection, samples)
        thread = beside(lambda: store.samples.add(row, lambda _: published.append("again"), key_id="b"))
        until(lambda: keeps_somebody_waiting(connection))
        connection.execute(delete(samples_keys))
        connection.execute(delete(samples))
    thread.join(300.0)
    assert store.samples.get("s-1", "b") is not None
    assert published == ["again"]
