"""The writer commits what waits in groups, and each change has its own result or error."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import Connection, event, text
from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import EngineError, KeyReusedError, QuotaError, StepTakenError
from equimesh_service.files.port import Removed, publish_nothing
from equimesh_service.problems.storage import storage_problem
from equimesh_service.store import keys
from equimesh_service.store import writer as module
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import (
    Artifact,
    Claim,
    Ending,
    FinishedMesh,
    Lease,
    NewEntry,
    NewMesh,
    NewSamples,
    NewStep,
    Outcome,
    SamplesRow,
)
from equimesh_service.store.store import Store
from equimesh_service.store.writer import Writer, store_finished
from service.store.stores import ERROR, SPEC, Clock, add, claimed, status

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


def step_of(number: int, name: str, value: bytes) -> NewEntry:
    """The mesh of a step that a worker has finished, with u at nodes and a field, whose files have these bytes."""
    files = {f"{kind}{number}" * 32: value for kind in "ab"}
    (u, fields), row = files, {"kind": "nodal"}
    nodal = SamplesRow(f"n-{number}", u, len(value), row, 0.0)
    step = NewStep(
        sequence_id="q-1",
        number=number,
        keep=2,
        fingerprint="",
        start="0" * 64,
        fields=Artifact("fields", fields, len(value)),
        functions=[(nodal, publish_nothing)],
        contents=files,
    )
    return NewEntry(new=NewMesh(id=name, spec=SPEC, samples=(nodal.id,)), step=step)


def test_of_two_steps_that_workers_have_finished_one_is_taken(store: Store, writer: Writer) -> None:
    removed: list[str] = []

    def finished(made: NewEntry) -> Callable[[], str | None]:
        ready = replace(FINISHED, entry=made, outcome=Outcome(result={}))
        return lambda: store_finished(store, Claim(made.new.id, 1), ready, removed.append)

    store.meshes.add_finished(step_of(0, "m-0", b"zero"), Outcome(result={}), seconds=1.0)
    with pytest.raises(StepTakenError):
        finished(step_of(2, "m-9", b"two"))()  # there is no step 1
    one, other = together(writer, [finished(step_of(1, name, b"one")) for name in ("m-1", "m-2")])
    assert (one.result(), type(other.exception())) == ("m-1", StepTakenError)
    assert store.meshes.get("m-2") is None
    assert store.samples.get("n-1") is not None
    files = BlobFiles(store.database, SimpleNamespace())  # type: ignore[arg-type]
    with files.opened("a1" * 32) as stream:
        assert stream.read() == b"one"
    assert removed == []
    (last,) = together(writer, [finished(step_of(2, "m-3", b"two"))])
    assert last.result() == "m-3"
    assert store.meshes.get("m-0") is None, "two are kept"
    assert set(removed) == {"a0" * 32, "b0" * 32}


def test_what_follows_a_commit_waits_for_it_and_cannot_undo_it(store: Store) -> None:
    called: list[bool] = []

    def call() -> None:
        called.append(store.meshes.get("m-0") is not None)
        raise OSError

    with suppress(ZeroDivisionError), store.database.write():
        store.database.when_committed(call)
        raise ZeroDivisionError
    with store.database.write():
        store.database.when_committed(call)
        store.meshes.add_finished(entry("m-0"), Outcome(result={}), seconds=1.0)
        assert called == []
    assert called == [True]
    store.database.when_committed(call)  # of a transaction that has ended
    assert called == [True, True]


def test_files_that_cannot_be_removed_do_not_refuse_the_step_that_is_stored(store: Store) -> None:
    def discard(_: str) -> None:
        raise SQLAlchemyError

    for number in range(4):
        made = step_of(number, f"m-{number}", b"")
        assert made.step is not None
        step = replace(made.step, discard=discard)
        if number == 3:
            assert store.meshes.add(made.new, step=step) == "m-3"
        else:
            added = store.meshes.add_finished(replace(made, step=step), Outcome(result={}), seconds=1.0)
            assert added == f"m-{number}"
    assert [row.id for row in store.meshes.page()] == ["m-3", "m-2"]


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


LEASE = Lease(owner="me", seconds=10.0)
SENT = NewSamples(SamplesRow("s-1", "5" * 64, 3, {"kind": "grid"}, 1000.0), b"npz")
FILE = Artifact("mesh", "0" * 64, 1)


def entered(mesh_id: str = "a", *, samples: NewSamples | None = None, key: str | None = None) -> NewEntry:
    names = () if samples is None else (samples.row.id,)
    new = NewMesh(id=mesh_id, spec=SPEC, samples=names, fingerprint=mesh_id, key_id="k")
    return NewEntry(new=new, samples=samples, key=key, fingerprint="f")


def finished_entry(
    store: Store, made: NewEntry, outcome: Outcome | None = None, published: list[str] | None = None
) -> str:
    published = [] if published is None else published

    def publish(name: str) -> Any:
        def note(_: Removed) -> None:
            published.append(name)

        return note

    outcome = replace(outcome or Outcome(result={}, files=[FILE]), publish=publish("mesh"))
    return store.meshes.add_finished(made, outcome, seconds=2.0, publish_samples=publish("samples"))


def enter(store: Store, made: NewEntry, quota: Quota | None = None) -> str:
    return store.meshes.add(made.new, key=made.key, fingerprint=made.fingerprint, quota=quota, lease=LEASE)


def test_a_finished_mesh_enters_with_its_samples_files_and_story(store: Store) -> None:
    published: list[str] = []
    assert finished_entry(store, entered(samples=SENT), published=published) == "a"
    row = store.meshes.get("a")
    assert (row.status, row.attempt, row.created_at, row.finished_at) == ("succeeded", 1, 998.0, 1000.0)
    assert store.meshes.artifact("a", "mesh") == FILE
    assert store.samples.get("s-1", "k") == SENT.row
    assert [event.data["status"] for event in store.meshes.events("a")] == ["queued", "running", "succeeded"]
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]
    assert published == ["samples", "mesh"]
    assert store.queue.claim("me", 10.0, "k") is None


def test_it_may_have_failed(store: Store) -> None:
    assert finished_entry(store, entered(), Outcome(error=ERROR, partial=True)) == "a"
    row = store.meshes.get("a")
    assert (row.status, row.error, row.partial) == ("failed", ERROR, True)
    assert store.meshes.events("a")[-1].data == {"status": "failed", "error": ERROR}


def test_a_mesh_that_is_entered_runs_and_its_worker_ends_it(store: Store) -> None:
    assert enter(store, entered()) == "a"
    assert status(store, "a") == "running"
    assert store.queue.find_held("me") == {Claim("a", 1)}
    assert store.queue.finish(Claim("a", 1))
    assert status(store, "a") == "succeeded"
    assert [event.kind for event in store.meshes.events("a")] == ["status", "status", "done"]


def test_samples_of_a_mesh_that_is_entered_are_kept_before(store: Store) -> None:
    store.samples.keep(SENT, "k")
    store.samples.keep(SENT, "k")
    assert enter(store, entered(samples=SENT)) == "a"
    assert store.samples.get("s-1", "k") == SENT.row
    assert store.samples.get("s-1", "other") is None


def test_an_entered_mesh_whose_service_is_silent_is_taken_over(store: Store, clock: Clock) -> None:
    enter(store, entered())
    clock.now += 11.0
    assert store.queue.find_abandoned() == [Claim("a", 1)]
    assert store.queue.lose(Claim("a", 1), "silent", most=3, error=ERROR) == "queued"
    assert not store.queue.finish(Claim("a", 1))  # the first attempt is over
    assert claimed(store, "other", "k") == Claim("a", 2)


@pytest.mark.parametrize("is_first_entered", [False, True])
def test_the_same_key_gives_the_same_mesh(store: Store, is_first_entered: bool) -> None:
    first, second = entered("a", key="x"), entered("b", key="x")
    assert not store.meshes.has_key("k", "x")
    assert enter(store, first) == "a" if is_first_entered else finished_entry(store, first) == "a"
    assert store.meshes.has_key("k", "x")
    assert not store.meshes.has_key("other", "x")
    assert finished_entry(store, second) == "a"
    assert enter(store, second) == "a"
    assert store.meshes.get("b") is None
    with pytest.raises(KeyReusedError):
        finished_entry(store, replace(second, fingerprint="other"))


def test_of_requests_with_the_same_key_there_is_one_mesh(store: Store) -> None:
    barrier, found = threading.Barrier(4), []

    def run(do: Any) -> None:
        barrier.wait()
        found.append(do())

    store.samples.keep(SENT, "k")
    made = [entered(name, samples=SENT, key="x") for name in "abcd"]
    acts = [lambda one=one, do=do: do(store, one) for one, do in zip(made, [finished_entry, enter] * 2, strict=True)]
    threads = [threading.Thread(target=run, args=(act,)) for act in acts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert {row.id for row in store.meshes.page()} == set(found)
    assert len(set(found)) == 1


def test_the_quota_holds_for_meshes_that_are_entered(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    store.quotas.check("k", 64, lambda: quota)
    enter(store, entered("a"), quota)
    with pytest.raises(QuotaError):
        store.quotas.check("k", 64, lambda: quota)
    with pytest.raises(QuotaError):
        enter(store, entered("b"), quota)
    assert store.meshes.get("b") is None


@pytest.mark.parametrize(
    ("limits", "limit"),
    [(Quota(queued=2, points=0), "key_max_queued"), (Quota(queued=0, points=200, most_points=100), "key_max_points")],
    ids=["meshes", "points"],
)
def test_the_quota_counts_meshes_in_flight(
    store: Store, monkeypatch: pytest.MonkeyPatch, limits: Quota, limit: str
) -> None:
    enter(store, entered("a"))
    waits: list[float] = []
    sleep = lambda seconds: (waits.append(seconds), enter(store, entered("b")))  # noqa: E731
    monkeypatch.setattr(keys, "time", SimpleNamespace(monotonic=time.monotonic, sleep=sleep))
    with pytest.raises(QuotaError) as refused:
        store.quotas.check("k", 100, lambda: replace(limits, in_flight=("a", "b")))
    assert (refused.value.limit, len(waits)) == (limit, 1)  # b was in flight, and then in the store
    store.queue.finish(Claim("b", 1))
    store.quotas.check("k", 100, lambda: replace(limits, in_flight=("a", "b")))
    monkeypatch.setattr(keys, "MAX_FLIGHT_SECONDS", -1.0)
    if limit == "key_max_queued":
        with pytest.raises(QuotaError):
            store.quotas.check("k", 100, lambda: replace(limits, in_flight=("never",)))
    else:
        store.quotas.check("k", 100, lambda: replace(limits, in_flight=("never",)))  # its points are not known


def test_a_mesh_in_flight_that_never_enters_the_store_makes_room(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    flying = [("refused", "reused"), ("reused",)]
    waits: list[float] = []
    monkeypatch.setattr(keys, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=waits.append))
    one = Quota(queued=1, points=0)
    store.quotas.check("k", 100, lambda: replace(one, in_flight=flying.pop(0) if flying else ()))
    assert len(waits) == 2


def test_a_repeated_key_gets_its_mesh_also_at_the_limit(store: Store) -> None:
    quota = Quota(queued=1, points=0)
    enter(store, entered("a", key="x"), quota)
    assert enter(store, entered("b", key="x"), quota) == "a"
