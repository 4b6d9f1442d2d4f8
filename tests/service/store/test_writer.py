"""The writer commits what waits in groups, and each change has its own result or error."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing
from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy import Connection, event, text
from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import EngineError, KeyReusedError
from equimesh_service.problems.storage import storage_problem
from equimesh_service.store import writer as module
from equimesh_service.store.rows import (
    Artifact,
    Claim,
    Ending,
    FinishedMesh,
    NewEntry,
    NewMesh,
    NewSamples,
    Outcome,
    SamplesRow,
)
from equimesh_service.store.store import Store
from equimesh_service.store.writer import Writer, store_finished
from service.store.stores import SPEC, add, claimed, status

CONTENTS = {"0" * 64: b"a mesh"}
FINISHED = FinishedMesh(
    outcome=Outcome(result={}, files=[Artifact("mesh", "0" * 64, 6)]),
    contents=CONTENTS,
    ending=Ending(status="succeeded"),
    seconds=1.0,
)


@pytest.fixture
def writer(store: Store) -> Iterator[Writer]:
    writer = Writer(store.database)
    yield writer
    writer.close()


@pytest.fixture
def commits(store: Store) -> list[Connection]:
    """The commits from now on."""
    seen: list[Connection] = []
    engine: Any = store.database._engine
    event.listen(engine, "commit", seen.append)
    return seen


def entry(mesh_id: str, key: str | None = None, fingerprint: str = "f") -> NewEntry:
    return NewEntry(new=NewMesh(id=mesh_id, spec=SPEC), key=key, fingerprint=fingerprint)


def together(writer: Writer, changes: list[Callable[[], Any]]) -> list[Future[Any]]:
    """The futures of changes that wait at the same moment."""
    begun, go = threading.Event(), threading.Event()

    def hold() -> None:
        begun.set()
        assert go.wait(30.0)

    first = writer.commit(hold)
    assert begun.wait(30.0)
    futures = [writer.commit(change) for change in changes]
    go.set()
    first.result(30.0)
    for future in futures:
        future.exception(30.0)
    return futures


def finish(store: Store, made: NewEntry) -> Callable[[], str | None]:
    return lambda: store_finished(store, Claim(made.new.id, 1), replace(FINISHED, entry=made))


def test_what_waits_is_committed_at_once(store: Store, writer: Writer, commits: list[Connection]) -> None:
    futures = together(writer, [finish(store, entry(f"m-{number}")) for number in range(16)])
    assert [future.result() for future in futures] == [f"m-{number}" for number in range(16)]
    assert len(commits) == 1
    assert {status(store, f"m-{number}") for number in range(16)} == {"succeeded"}


def test_more_than_one_group_are_several(
    store: Store, commits: list[Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", most := 6)
    with closing(Writer(store.database)) as writer:
        together(writer, [finish(store, entry(f"m-{number}")) for number in range(most)])
        more = [writer.commit(finish(store, entry(f"n-{number}"))) for number in range(2 * most)]
        assert [future.result(60.0) for future in more] == [f"n-{number}" for number in range(2 * most)]
    assert len(store.meshes.page(limit=1000)) == 3 * most
    assert len(commits) >= 3


def test_the_bytes_of_files_and_samples_come_with_the_mesh(store: Store, writer: Writer) -> None:
    sent = NewSamples(SamplesRow("s-1", "5" * 64, 3, {}, 1.0), b"npz")
    made = NewEntry(new=NewMesh(id="a", spec=SPEC, samples=("s-1",)), samples=sent)
    assert writer.commit(finish(store, made)).result(30.0) == "a"
    with store.database.read() as connection:
        rows = connection.execute(text("SELECT sha256, content FROM blobs ORDER BY sha256")).all()
    assert [(sha256, bytes(content)) for sha256, content in rows] == [("0" * 64, b"a mesh"), ("5" * 64, b"npz")]


def test_a_refused_change_is_undone_alone(store: Store, writer: Writer, commits: list[Connection]) -> None:
    made = [entry("a", "key", "f"), entry("b", "key", "other"), entry("c", "key", "f"), entry("d")]
    a, b, c, d = together(writer, [finish(store, one) for one in made])
    assert (a.result(), c.result(), d.result()) == ("a", "a", "d")
    assert isinstance(b.exception(), KeyReusedError)
    assert sorted(row.id for row in store.meshes.page()) == ["a", "d"]
    assert len(commits) == 1


def test_where_the_group_fails_each_is_made_alone(store: Store, writer: Writer) -> None:
    def broken() -> None:
        with store.database.write() as connection:
            connection.execute(text("INSERT INTO nowhere VALUES (1)"))

    a, b, c = together(writer, [finish(store, entry("a")), broken, finish(store, entry("c"))])
    assert (a.result(), c.result()) == ("a", "c")
    assert isinstance(b.exception(), SQLAlchemyError)
    assert sorted(row.id for row in store.meshes.page()) == ["a", "c"]


def test_a_mesh_of_the_queue_ends_once(store: Store, writer: Writer) -> None:
    add(store, "a")
    claim = claimed(store)
    one, two = together(writer, [lambda: store_finished(store, claim, FINISHED)] * 2)
    assert (one.result(), two.result()) == ("a", None)
    assert [event.kind for event in store.meshes.events("a")].count("done") == 1


def test_a_closed_writer_has_committed_what_waited_and_takes_no_more(store: Store) -> None:
    writer = Writer(store.database)
    futures = [writer.commit(finish(store, entry(f"m-{number}"))) for number in range(8)]
    writer.close()
    assert [future.done() for future in futures] == [True] * 8
    with pytest.raises(EngineError, match="stopping"):
        writer.commit(lambda: None)
    writer.close()


@pytest.mark.parametrize("address", ["sqlite"], indirect=True)
def test_on_a_full_disk_each_mesh_is_stored_whole_or_refused(store: Store, address: str) -> None:
    with store.database.read() as connection:
        pages = int(connection.execute(text("PRAGMA page_count")).scalar_one())
    small_disk = Store(address)
    engine: Any = small_disk.database._engine
    event.listen(engine, "connect", lambda connection, _: connection.execute(f"PRAGMA max_page_count={pages + 200}"))
    writer = Writer(small_disk.database)

    def large(number: int) -> Callable[[], str | None]:
        name, made = f"{number:064}", entry(f"m-{number}")
        files = [Artifact("mesh", name, 200_000)]
        finished = replace(
            FINISHED, entry=made, outcome=Outcome(result={}, files=files), contents={name: bytes(200_000)}
        )
        return lambda: store_finished(small_disk, Claim(made.new.id, 1), finished)

    futures = together(writer, [large(number) for number in range(8)])
    writer.close()
    stored = {future.result() for future in futures if future.exception() is None}
    problems = [storage_problem(error) for future in futures if (error := future.exception()) is not None]
    assert 0 < len(stored) < 8
    assert {problem and problem.name for problem in problems} == {"storage-full"}
    assert {row.id for row in store.meshes.page()} == stored
    with store.database.read() as connection:
        assert connection.execute(text("SELECT count(*) FROM blobs")).scalar() == len(stored)
        assert connection.execute(text("PRAGMA integrity_check")).scalar() == "ok"
    small_disk.close()


# Prints what is committed, and dies in the middle of a group.
DYING = """
import os, signal, sys, threading
from service.store.test_writer import entry, finish, together
from equimesh_service.store.store import Store
from equimesh_service.store.writer import Writer

store = Store(sys.argv[1])
writer = Writer(store.database)
for future in together(writer, [finish(store, entry(f"m-{number}")) for number in range(5)]):
    print(future.result(), flush=True)
die = lambda: os.kill(os.getpid(), signal.SIGKILL)
together(writer, [finish(store, entry("n-0")), finish(store, entry("n-1")), die, finish(store, entry("n-2"))])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_process_that_is_killed_in_a_group_has_what_it_told_and_nothing_of_the_group(
    store: Store, address: str
) -> None:
    folders = [entry for entry in sys.path if entry]
    program = f"import sys; sys.path[:0] = {folders!r}\n{DYING}"
    done = subprocess.run([sys.executable, "-c", program, address], capture_output=True, text=True, timeout=120)
    assert done.returncode == -9, done.stderr
    told = done.stdout.split()
    assert told == [f"m-{number}" for number in range(5)]
    assert sorted(row.id for row in store.meshes.page()) == told
    assert Writer(store.database).commit(finish(store, entry("n-0"))).result(30.0) == "n-0"
