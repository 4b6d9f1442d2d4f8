"""The store keeps its promises: order, fencing, leases, idempotency, files that are shared."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from equimesh_service.api.cursors import cursor_of, position_of
from equimesh_service.spec.mesh import read_spec
from equimesh_service.store.rows import Artifact, Claim, Hold, KeyReusedError, NewMesh, SamplesGoneError, SamplesRow
from equimesh_service.store.schema import metadata
from equimesh_service.store.store import Store
from service.databases import database

SPEC = {"label": None, "grid": {"n_xi": 8, "n_eta": 8}, "cells": "quad"}
ERROR = {"type": "/problems/worker-lost"}


class Clock:
    """A time that the test moves."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


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


def test_oldest_mesh_is_claimed_first_and_only_once(store: Store) -> None:
    add(store, "a")
    add(store, "b")
    assert [store.queue.claim("me", 10.0), store.queue.claim("me", 10.0), store.queue.claim("me", 10.0)] == [
        Claim("a", 1),
        Claim("b", 1),
        None,
    ]


def test_concurrent_claims_never_share_a_mesh(store: Store) -> None:
    for number in range(20):
        add(store, f"m{number}")
    claims: list[Claim | None] = []

    def take() -> None:
        claims.extend(store.queue.claim(threading.current_thread().name, 10.0) for _ in range(5))

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({claim.mesh_id for claim in claims if claim}) == 20


def test_events_are_numbered_without_gaps_and_tell_the_story(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)
    assert store.queue.progress(claim, {"fraction": 0.5})
    assert store.queue.finish(claim, result={"quality": None})
    events = store.meshes.events("a")
    assert [event.number for event in events] == [1, 2, 3, 4]
    assert [event.kind for event in events] == ["status", "status", "progress", "done"]
    assert [event.number for event in store.meshes.events("a", after=2)] == [3, 4]


def test_a_lost_attempt_cannot_write(store: Store) -> None:
    add(store, "a")
    old = claimed(store)
    assert store.queue.lose(old, "gone", most=3, error=ERROR) == "queued"
    new = claimed(store)
    assert not store.queue.progress(old, {"fraction": 0.9})
    assert not store.queue.finish(old, files=[Artifact("mesh", "0" * 64, 1)])
    assert store.meshes.artifact("a", "mesh") is None
    assert status(store, "a") == "running"
    assert store.queue.finish(new)
    assert status(store, "a") == "succeeded"


def test_publishing_happens_only_for_the_attempt_that_counts(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)
    published: list[str] = []
    store.queue.cancel("a")
    assert not store.queue.finish(claim, publish=lambda _: published.append("late"))
    assert published == []


def test_a_failed_publication_leaves_the_mesh_running(store: Store) -> None:
    add(store, "a")
    claim = claimed(store)

    def fail(_: object) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        store.queue.finish(claim, files=[Artifact("mesh", "0" * 64, 1)], publish=fail)
    assert status(store, "a") == "running"
    assert store.meshes.artifact("a", "mesh") is None


def test_a_mesh_fails_when_its_workers_are_lost_too_often(store: Store) -> None:
    add(store, "a")
    outcomes = [store.queue.lose(claimed(store), "gone", most=3, error=ERROR) for _ in range(3)]
    assert outcomes == ["queued", "queued", "failed"]
    row = store.meshes.get("a")
    assert row is not None
    assert (row.attempt, row.error) == (3, ERROR)


def test_a_stop_of_the_service_does_not_count_as_a_loss(store: Store) -> None:
    add(store, "a")
    for _ in range(5):
        assert store.queue.requeue(claimed(store), "stopped")
    assert store.queue.lose(claimed(store), "gone", most=3, error=ERROR) == "queued"


def test_leases_run_out_unless_they_are_renewed(store: Store, clock: Clock) -> None:
    add(store, "a")
    claim = claimed(store)
    clock.now += 9.0
    assert store.queue.abandoned() == []
    assert store.queue.renew("me", 10.0) == {claim}
    clock.now += 9.0
    assert store.queue.abandoned() == []
    clock.now += 2.0
    assert store.queue.abandoned() == [claim]


def test_a_new_owner_sees_what_another_one_left(store: Store) -> None:
    add(store, "a")
    claim = claimed(store, "old")
    assert store.queue.abandoned(owner_gone="old") == []
    assert store.queue.abandoned(owner_gone="new") == [claim]


def test_cancel_works_until_the_end(store: Store) -> None:
    add(store, "a")
    assert store.queue.cancel("a")
    assert not store.queue.cancel("a")
    assert not store.queue.cancel("nothing")
    assert store.meshes.events("a")[-1].data == {"status": "canceled"}


def test_the_same_key_gives_the_same_mesh(store: Store) -> None:
    first = store.meshes.add(NewMesh(id="a", spec=SPEC), key="k", fingerprint="f")
    again = store.meshes.add(NewMesh(id="b", spec=SPEC), key="k", fingerprint="f")
    assert (first, again) == ("a", "a")
    assert store.meshes.get("b") is None
    with pytest.raises(KeyReusedError):
        store.meshes.add(NewMesh(id="c", spec=SPEC), key="k", fingerprint="other")
    store.meshes.delete("a", lambda _: None)
    assert store.meshes.add(NewMesh(id="d", spec=SPEC), key="k", fingerprint="f") == "d"


def test_the_same_key_at_the_same_moment_gives_one_mesh(store: Store) -> None:
    found: list[str] = []
    barrier = threading.Barrier(6)

    def ask(number: int) -> None:
        barrier.wait()
        found.append(store.meshes.add(NewMesh(id=f"m{number}", spec=SPEC), key="k", fingerprint="f"))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 6
    assert len(set(found)) == 1
    assert len(store.meshes.page()) == 1


def test_list_filters_and_pages(store: Store) -> None:
    for number in range(5):
        add(store, f"m{number}", label="odd" if number % 2 else "even")
    assert [row.id for row in store.meshes.page(limit=2)] == ["m4", "m3"]
    assert [row.id for row in store.meshes.page(before=(store.meshes.page(limit=2)[-1].number,))] == ["m2", "m1", "m0"]
    assert [row.id for row in store.meshes.page(label="odd")] == ["m3", "m1"]
    store.queue.cancel("m0")
    assert [row.id for row in store.meshes.page(status="canceled")] == ["m0"]


def test_a_file_goes_with_the_last_mesh_that_has_it(store: Store) -> None:
    shared, own = "1" * 64, "2" * 64
    for mesh_id, files in (("a", [Artifact("mesh", shared, 1), Artifact("quality", own, 1)]), ("b", [])):
        add(store, mesh_id)
        store.queue.finish(claimed(store), files=[*files, Artifact("convergence", shared, 1)])
    removed: list[str] = []
    assert store.meshes.delete("a", removed.append)
    assert removed == [own]
    assert store.meshes.delete("b", removed.append)
    assert removed == [own, shared]
    assert not store.meshes.delete("b", removed.append)


def test_samples_that_a_waiting_mesh_needs_stay(store: Store) -> None:
    row = SamplesRow("s-1", "3" * 64, 10, {"kind": "grid"}, 1.0)
    assert store.samples.add(row)
    assert not store.samples.add(row)
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1",)))
    removed: list[str] = []
    assert store.samples.delete("s-1", removed.append) is False
    store.queue.cancel("a")
    assert store.samples.delete("s-1", removed.append) is True
    assert removed == ["3" * 64]
    assert store.samples.delete("s-1", removed.append) is None
    with pytest.raises(SamplesGoneError):
        store.meshes.add(NewMesh(id="b", spec=SPEC, samples=("s-1",)))


def test_sqlite_writes_ahead_and_to_disk(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    with store.database.read() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2
        assert connection.execute(text("PRAGMA foreign_keys")).scalar() == 1
    store.close()


def test_every_sample_of_a_mesh_is_kept_until_it_is_finished(store: Store) -> None:
    for name in ("s-1", "s-2"):
        store.samples.add(SamplesRow(name, name, 1, {}, 0.0))
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1", "s-2")))
    gone: list[str] = []
    assert [store.samples.delete(name, gone.append) for name in ("s-1", "s-2")] == [False] * 2
    store.queue.cancel("a")
    assert store.samples.delete("s-2", gone.append) is True
    assert store.meshes.delete("a", gone.append)
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["s-2", "s-1"]


def test_a_spec_of_the_first_release_is_read(store: Store) -> None:
    old = {
        "monitor": {"kind": "arc_length", "u": {"expression": "x", "parameters": {}, "t": 0.0}, "a": 0.7, "b": 0.05},
        "domain": {"kind": "rectangle", "x": [0.0, 1.0], "y": [0.0, 1.0]},
        "grid": {"n_xi": 8, "n_eta": 8},
        "boundary": "trace",
        "initial": "nested",
        "schwarz": None,
        "cells": "quad",
        "label": None,
    }
    store.meshes.add(NewMesh(id="a", spec=old))
    checked = read_spec(store.meshes.spec("a"))
    spec, canonical = checked.spec, checked.canonical
    assert (spec.mode, spec.allow_relaxed, spec.monitor.smoothing) == ("discretization", True, 0.0)
    assert {key: canonical[key] for key in old if key != "monitor"} == {k: v for k, v in old.items() if k != "monitor"}


def test_samples_of_two_keys_are_stored_once_and_are_each_ones_own(store: Store) -> None:
    row, later = SamplesRow("s-1", "3" * 64, 10, {}, 1.0), SamplesRow("s-1", "3" * 64, 10, {}, 2.0)
    published: list[str] = []
    assert store.samples.add(row, lambda _: published.append("a"), key_id="a")
    assert store.samples.get("s-1", "b") is None
    assert store.samples.add(later, lambda _: published.append("b"), key_id="b")
    assert published == ["a"]
    assert (store.samples.get("s-1", "a"), store.samples.get("s-1", "b")) == (row, later)
    assert store.samples.get("s-1") == row
    gone: list[str] = []
    store.meshes.add(NewMesh(id="m", spec=SPEC, samples=("s-1",), key_id="a"))
    assert store.samples.delete("s-1", gone.append, "c") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    assert store.samples.delete("s-1", gone.append, "b") is True
    assert store.samples.get("s-1", "b") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    store.queue.cancel("m")
    assert gone == []
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["3" * 64]


def test_each_key_has_its_own_list_and_its_own_idempotency_keys(store: Store) -> None:
    for owner in ("a", "b"):
        new = NewMesh(id=f"of-{owner}", spec=SPEC, key_id=owner)
        assert store.meshes.add(new, key="k", fingerprint=owner) == new.id
    assert [row.id for row in store.meshes.page(key_id="a")] == ["of-a"]
    assert [row.id for row in store.meshes.page()] == ["of-b", "of-a"]


@pytest.mark.parametrize("key_id", [None, ""], ids=["all", "own"])
def test_a_page_neither_leaves_out_nor_repeats_while_meshes_come_and_go(
    store: Store, clock: Clock, key_id: str | None
) -> None:
    for number in range(12):
        add(store, f"m{number}")
        clock.now += number % 2  # some are made at the same moment
    seen: list[str] = []
    cursor, came = None, 0
    while page := store.meshes.page(
        key_id=key_id, before=None if cursor is None else position_of(cursor, key_id), limit=3
    ):
        seen += [row.id for row in page]
        cursor = cursor_of(page[-1], key_id)
        clock.now += 0.001
        add(store, f"new{came}")
        store.meshes.delete(seen[-1], lambda _: None)  # the very row that the next page begins after
        store.meshes.delete(f"m{came}", lambda _: None)  # from the other end
        came += 1
    kept = [name for number in range(12) if store.meshes.get(name := f"m{number}")]
    assert len(seen) == len(set(seen))
    left = [name for name in seen if store.meshes.get(name)]
    assert (left[::-1] if key_id is None else sorted(left, key=kept.index)) == kept
    assert not any(name.startswith("new") for name in seen)


def test_ids_that_no_database_takes_are_not_there(store: Store) -> None:
    assert store.meshes.get("m\x00") is None
    assert not store.queue.cancel("m\x00")
    assert not store.meshes.delete("m\x00", lambda _: None)
    assert store.samples.get("s\x00", "") is None


def succeeded(store: Store, mesh_id: str, fingerprint: str = "f", **more: Any) -> None:
    store.meshes.add(NewMesh(id=mesh_id, spec=SPEC, fingerprint=fingerprint, **more))
    result = {"quality": {"min_jacobian": 1.0}, "timings": {"solve": 2.0}}
    files = [Artifact("mesh", "4" * 64, 9), Artifact("file:vtu:quad", "5" * 64, 8)]
    assert store.queue.finish(claimed(store), result=result, files=files)


def again(store: Store, mesh_id: str = "again", fingerprint: str | None = "f", **more: Any) -> str | None:
    return store.meshes.reuse(NewMesh(id=mesh_id, spec={**SPEC, "label": "new"}, fingerprint=fingerprint, **more))


def test_a_mesh_that_has_succeeded_is_handed_on(store: Store) -> None:
    assert again(store) is None
    succeeded(store, "first")
    assert again(store) == "again"
    row = store.meshes.get("again")
    assert row is not None
    assert (row.status, row.label, row.reused_from, row.attempt) == ("succeeded", "new", "first", 0)
    assert row.result == {"quality": {"min_jacobian": 1.0}}  # how long it took is not a matter of this one
    assert [(event.kind, event.data["reused_from"]) for event in store.meshes.events("again")] == [("done", "first")]
    gone: list[str] = []
    assert store.meshes.delete("first", gone.append)
    assert gone == []
    assert store.meshes.artifact("again", "file:vtu:quad") == Artifact("file:vtu:quad", "5" * 64, 8)
    assert again(store, "third") == "third"  # of the second, now that the first is gone
    assert store.meshes.delete("again", gone.append)
    assert store.meshes.delete("third", gone.append)
    assert sorted(gone) == ["4" * 64, "5" * 64]


def test_only_what_has_succeeded_for_the_same_key_is_handed_on(store: Store) -> None:
    succeeded(store, "other", key_id="other")
    store.meshes.add(NewMesh(id="failed", spec=SPEC, fingerprint="f"))
    store.queue.finish(claimed(store), error=ERROR)
    store.meshes.add(NewMesh(id="canceled", spec=SPEC, fingerprint="f"))
    store.queue.cancel("canceled")
    store.meshes.add(NewMesh(id="waits", spec=SPEC, fingerprint="f"))
    assert again(store) is None
    assert again(store, fingerprint=None) is None
    assert again(store, key_id="other") == "again"


def test_handing_on_heeds_the_idempotency_key(store: Store) -> None:
    succeeded(store, "first")
    new = [NewMesh(id=f"m{number}", spec=SPEC, fingerprint="f") for number in range(3)]
    assert [store.meshes.reuse(mesh, key="k", fingerprint="x") for mesh in new] == ["m0"] * 3
    with pytest.raises(KeyReusedError):
        store.meshes.reuse(new[1], key="k", fingerprint="other")


def test_handing_on_while_the_first_is_deleted_never_leaves_a_mesh_without_files(store: Store) -> None:
    removed: list[str] = []
    for _ in range(5):
        succeeded(store, "first")
        barrier = threading.Barrier(2)

        def delete(barrier: threading.Barrier = barrier) -> None:
            barrier.wait()
            store.meshes.delete("first", removed.append)

        thread = threading.Thread(target=delete)
        thread.start()
        barrier.wait()
        handed_on = again(store) is not None
        thread.join()
        assert (store.meshes.artifact("again", "mesh") is not None) == handed_on
        assert ("4" * 64 in removed) != handed_on
        store.meshes.delete("again", removed.append)
        removed.clear()


def test_only_what_is_promised_waits_for_the_disk(store: Store, address: str) -> None:
    query = "PRAGMA synchronous" if address.startswith("sqlite") else "SHOW synchronous_commit"
    waits, goes_on = (2, 1) if address.startswith("sqlite") else ("on", "off")
    hasty = Store(address, durable=False)
    for one, durable, expected in ((store, True, waits), (store, False, goes_on), (store, True, waits)):
        with one.database.write(durable=durable) as connection:
            assert connection.execute(text(query)).scalar() == expected
    with hasty.database.write() as connection:
        assert connection.execute(text(query)).scalar() == goes_on
    hasty.close()


def test_a_mesh_that_somebody_waits_for_is_claimed_from_the_start(store: Store, clock: Clock) -> None:
    hold = Hold(owner="me", lease=10.0)
    store.meshes.add(NewMesh(id="a", spec=SPEC), hold=hold)
    assert store.queue.claim("other", 10.0) is None
    assert [event.data["status"] for event in store.meshes.events("a")] == ["queued", "running"]
    assert store.queue.renew("me", 10.0) == {Claim("a", 1)}
    clock.now += 11.0
    assert store.queue.abandoned() == [Claim("a", 1)]
    assert store.queue.finish(Claim("a", 1))
    assert [event.number for event in store.meshes.events("a")] == [1, 2, 3]
