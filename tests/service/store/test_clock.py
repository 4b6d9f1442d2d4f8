"""The time of a database, on machines whose clocks are wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from equimesh_service.store import clock as clock_module
from equimesh_service.store.clock import ServerClock, describe_skew
from equimesh_service.store.rows import NewMesh
from equimesh_service.store.store import Store
from service.databases import Postgres
from service.store.stores import SPEC, claimed

_HOUR = 3600.0


@contextmanager
def shifted(monkeypatch: pytest.MonkeyPatch, seconds: float) -> Iterator[None]:
    """This machine's clock, off by so many seconds."""
    real = time.time
    with monkeypatch.context() as patch:
        patch.setattr(time, "time", lambda: real() + seconds)
        yield


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_wrong_clock_changes_no_time_of_the_store(
    postgres: Postgres, monkeypatch: pytest.MonkeyPatch, hours: int
) -> None:
    with postgres.database() as url:
        right, began = Store(url), time.time()
        right.prepare()
        with shifted(monkeypatch, hours * _HOUR):
            wrong = Store(url)
            for store, other in ((right, wrong), (wrong, right)):
                name = f"m{hours}{store is right}"
                store.meshes.add(NewMesh(id=name, spec=SPEC))
                claim = claimed(store, "me")
                assert other.queue.find_abandoned() == []
                assert store.queue.renew("me", 10.0) == {claim}
                assert other.queue.find_abandoned() == []
                assert other.retention.retire_meshes(60.0, lambda _: None) == 0
                assert store.queue.finish(claim)
                assert other.retention.retire_meshes(60.0, lambda _: None) == 0
            rows, after = wrong.meshes.page(), wrong.clock()
        times = [seconds for row in rows for seconds in (row.created_at, row.started_at, row.finished_at)]
        assert len(times) == 6
        assert all(began - 1.0 < seconds < time.time() + 1.0 for seconds in (after, *times) if seconds is not None)
        right.close()
        wrong.close()


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_wrong_clock_is_reported(postgres: Postgres, monkeypatch: pytest.MonkeyPatch, hours: int) -> None:
    with postgres.database() as url:
        store = Store(url)
        assert store.clock_warning() is None
        with shifted(monkeypatch, hours * _HOUR):
            assert store.clock_warning() is not None
        store.close()
    assert describe_skew(3601.0) == "this machine's clock is 3601 s ahead of that of the database"
    assert describe_skew(-8.0) == "this machine's clock is 8 s behind that of the database"
    assert describe_skew(-2.0) is None


class Server:
    """A server whose time, count of seconds and answers a test makes. Its transactions are themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count, self.ahead, self.reads = 0.0, 1000.0, 0
        self.delays: list[float] = []
        self.clock = ServerClock(self.begin)
        monkeypatch.setattr(clock_module, "count_seconds", lambda: self.count)

    @contextmanager
    def begin(self) -> Iterator[Any]:
        self.clock.follow(self)  # type: ignore[arg-type]
        yield self

    def execute(self, _: object) -> Server:
        self.reads += 1
        return self

    def scalar_one(self) -> float:
        delay = self.delays.pop(0) if self.delays else 0.0
        self.count += delay
        now = self.count + self.ahead
        self.count += delay
        return now


def test_a_reading_lasts_for_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    server = Server(monkeypatch)
    for _ in range(100):
        assert server.clock() == server.count + 1000.0
        server.count += 1.0
        with server.begin():
            pass
    assert server.reads == 11
    server.ahead = 2000.0  # somebody has set the server's clock
    for _ in range(10):
        server.count += 1.0
        with server.begin():
            pass
    assert server.clock() == server.count + 2000.0


def test_a_slow_reading_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    server = Server(monkeypatch)
    server.delays = [30.0, 0.3, 0.1]
    assert server.clock() == server.count + 1000.0
    assert (server.reads, server.delays) == (3, [])
    server.count += 11.0
    server.delays = [30.0] * 5  # a machine that is that slow has to go on with something
    with server.begin():
        pass
    assert len(server.delays) == 2


def test_nobody_waits_for_a_reading_that_another_makes(monkeypatch: pytest.MonkeyPatch) -> None:
    server, go_on = Server(monkeypatch), threading.Event()
    assert server.clock() == 1000.0
    server.count += 11.0
    monkeypatch.setattr(server, "scalar_one", lambda: (go_on.wait(60.0), server.count + 1000.0)[1])
    reader = threading.Thread(target=lambda: server.clock.follow(server))  # type: ignore[arg-type]
    reader.start()
    while server.reads < 2:
        time.sleep(0.01)
    with server.begin():
        assert server.clock() == server.count + 1000.0
    assert reader.is_alive()
    go_on.set()
    reader.join()
    assert server.reads == 2


def test_sqlite_has_the_time_of_its_machine(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with shifted(monkeypatch, _HOUR):
        store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
        assert store.clock() == pytest.approx(time.time(), abs=60.0)
        assert store.clock_warning() is None
        store.close()
