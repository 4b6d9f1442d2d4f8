"""A mesh whose request waits goes straight to a free worker, and never overtakes a queue."""

from __future__ import annotations

import asyncio
import errno
import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from equimesh_service.dispatch import dispatcher as dispatcher_module
from equimesh_service.dispatch.dispatcher import Dispatcher, Rules
from equimesh_service.engine.port import Health
from equimesh_service.errors import EngineError, SchedulerLostError, WorkerLostError
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import Claim, Ending, FinishedMesh, KeysInQueue, MeshInput, NewMesh, Outcome
from equimesh_service.store.store import Store
from service.conftest import until
from service.store.stores import add_backlog, status

SPEC: dict[str, Any] = {"label": None, "grid": {"n_xi": 8, "n_eta": 8}, "cells": "quad"}
MESH_INPUT = MeshInput(spec=SPEC, samples={})


class Patient:
    """An engine of two workers whose tasks end when a test ends them."""

    def __init__(self) -> None:
        self.tasks: list[Future[Any]] = []
        self.canceled: list[Future[Any]] = []
        self.closed = False

    def submit(self, function: Any, *arguments: Any, time_limit: float | None = None) -> Future[Any]:
        if self.closed:
            raise EngineError("closed")
        assert (function, arguments, time_limit) == (print, (), 300.0)
        self.tasks.append(Future())
        return self.tasks[-1]

    def cancel(self, task: Future[Any]) -> None:
        self.canceled.append(task)

    def health(self) -> Health:
        return Health(ready=True, workers=2)

    def close(self) -> None:
        raise AssertionError


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    yield store
    store.close()


@pytest.fixture
def engine() -> Patient:
    return Patient()


@pytest.fixture
def dispatcher(store: Store, engine: Patient) -> Iterator[Dispatcher]:
    rules = Rules(lease=3.0, poll=0.01)
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), rules, lambda _: None)
    dispatcher.start(alone=True)
    yield dispatcher
    dispatcher.stop()


def test_as_many_are_taken_as_there_are_workers(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)  # not at once where the queue is looked at in this moment
    assert not dispatcher.line.reserve()
    dispatcher.line.release()
    until(dispatcher.line.reserve)
    for name in ("a", "b"):
        store.meshes.add(NewMesh(id=name, spec=SPEC), lease=dispatcher.lease)
        dispatcher.begin(Claim(name, 1), MESH_INPUT)
    assert not dispatcher.line.reserve()
    store.queue.finish(Claim("a", 1))
    engine.tasks[0].set_result(None)
    until(dispatcher.line.reserve)
    assert not dispatcher.line.reserve()


def test_who_waits_in_the_queue_is_not_overtaken(store: Store, engine: Patient) -> None:
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    assert not dispatcher.line.reserve()  # it has not looked at the queue yet
    dispatcher.start(alone=True)
    until(lambda: len(engine.tasks) == 1)
    until(dispatcher.line.reserve)  # the second worker, now that nobody waits
    dispatcher.stop()


def test_a_worker_that_takes_nothing_stays_reserved(dispatcher: Dispatcher, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    engine.closed = True
    with pytest.raises(EngineError):
        dispatcher.begin(Claim("a", 1), MESH_INPUT)
    dispatcher.line.release()
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    assert not dispatcher.line.reserve()


def test_nobody_overtakes_while_the_queue_is_looked_at(
    store: Store, engine: Patient, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        store.meshes.add(NewMesh(id=name, spec=SPEC))
    claim, overtook = store.queue.claim, []

    def look(owner: str, lease: float, key_id: str) -> Claim | None:
        overtook.append(dispatcher.line.reserve())
        return claim(owner, lease, key_id)

    monkeypatch.setattr(store.queue, "claim", look)
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    dispatcher.start(alone=True)
    until(lambda: len(engine.tasks) == 2)
    dispatcher.stop()
    assert overtook == [False, False]


def test_a_worker_that_a_claimed_mesh_needs_is_given_to_nobody_else(
    store: Store, engine: Patient, monkeypatch: pytest.MonkeyPatch
) -> None:
    find, claim = store.queue.find_waiting, store.queue.claim
    overtook, turns = list[bool](), list[Future[bool]]()

    def look() -> KeysInQueue:
        overtook.append(dispatcher.line.reserve())
        return find()

    def take(owner: str, lease: float, key_id: str) -> Claim | None:
        overtook.append(dispatcher.line.reserve())
        found = claim(owner, lease, key_id)
        turns.append(dispatcher.line.join())
        return found

    monkeypatch.setattr(engine, "health", lambda: Health(ready=True, workers=1))
    monkeypatch.setattr(store.queue, "find_waiting", look)
    monkeypatch.setattr(store.queue, "claim", take)
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    dispatcher.start(alone=True)
    until(lambda: len(overtook) > 2)  # it takes the queue for empty
    store.meshes.add(NewMesh(id="a", spec=SPEC))  # of another service, which wakes nobody here
    until(lambda: engine.tasks)
    assert not any(overtook)
    assert not turns[0].done()
    store.queue.finish(Claim("a", 1))
    engine.tasks[0].set_result(None)
    assert turns[0].result(300.0)
    dispatcher.stop()


def test_a_claim_that_never_reaches_a_worker_goes_back(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    store.meshes.add(NewMesh(id="a", spec=SPEC), lease=dispatcher.lease)
    dispatcher.line.release()  # whoever asked for it is gone
    until(lambda: len(engine.tasks) == 1)
    story = [event.data for event in store.meshes.events("a")]
    assert [told["status"] for told in story] == ["queued", "running", "queued", "running"]
    assert story[2]["reason"] == "it had not reached a worker"


def test_a_lost_scheduler_is_no_loss_of_the_mesh(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.wake()
    for number in range(Rules().max_attempts + 2):
        until(lambda number=number: len(engine.tasks) == number + 1)
        engine.tasks[-1].set_exception(SchedulerLostError("gone"))
    until(lambda: len(engine.tasks) == Rules().max_attempts + 3)
    assert status(store, "a") == "running"
    reasons = [event.data.get("reason") for event in store.meshes.events("a") if event.data["status"] == "queued"]
    assert reasons == [None, *(Rules().max_attempts + 2) * ["the scheduler of the cluster was lost"]]


def test_a_new_mesh_is_not_gone_before_it_is_in_the_store(store: Store, engine: Patient) -> None:
    attempts: list[float] = []
    metrics: Any = SimpleNamespace(count_attempt=attempts.append)
    dispatcher = Dispatcher(
        "me", store, engine, lambda *_: (print, ()), Rules(), lambda _: None, metrics
    )  # not started
    dispatcher.line.queue_is_empty = True
    assert dispatcher.line.reserve()
    task = dispatcher.begin_request(Claim("a", 1, key_id="k"), print)
    for _ in range(3):
        dispatcher._cancel_gone()
    assert engine.canceled == []
    assert (dispatcher.in_flight("k"), dispatcher.in_flight("l")) == (("a",), ())
    store.meshes.add(NewMesh(id="a", spec=SPEC), lease=dispatcher.lease)  # as its worker does
    dispatcher._cancel_gone()
    assert (dispatcher.in_flight("k"), attempts) == ((), [0.0])
    assert store.queue.cancel("a")  # from now on it is a mesh like every other
    for _ in range(2):
        dispatcher._cancel_gone()
    assert len(engine.canceled) == 1
    assert not task.done()


def test_a_dispatcher_that_is_stuck_is_not_alive(
    store: Store, engine: Patient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatcher_module, "_MAX_ROUND_SECONDS", 0.2)
    go_on = threading.Event()
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    dispatcher.start(alone=True)
    until(lambda: dispatcher.is_alive())
    monkeypatch.setattr(engine, "health", lambda: (go_on.wait(300.0), Health(ready=True, workers=2))[1])
    until(lambda: not dispatcher.is_alive())
    go_on.set()
    until(lambda: dispatcher.is_alive())
    dispatcher.stop()
    assert not dispatcher.is_alive()


def _finish(store: Store, engine: Patient, number: int, name: str) -> None:
    """End the mesh of a task, as its worker does."""
    store.queue.finish(Claim(name, 1))
    engine.tasks[number].set_result(Ending(status="succeeded"))


def _hold(dispatcher: Dispatcher, store: Store, name: str) -> None:
    store.meshes.add(NewMesh(id=name, spec=SPEC), lease=dispatcher.lease)
    dispatcher.begin(Claim(name, 1), MESH_INPUT)


def test_a_line_forms_where_no_worker_is_free(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    _hold(dispatcher, store, "a")
    assert dispatcher.line.join().result(300.0) is True
    first, second, third = (dispatcher.line.join() for _ in range(3))
    assert not any(turn.done() for turn in (first, second, third))
    _finish(store, engine, 0, "a")
    assert first.result(0) is True  # at once: no thread has to come round
    assert not second.done()
    dispatcher.line.leave(second)
    dispatcher.line.release()
    assert third.result(0) is True
    assert not second.done()


def test_a_worker_that_came_too_late_is_given_to_the_next(dispatcher: Dispatcher) -> None:
    until(dispatcher.line.reserve)
    late = dispatcher.line.join()
    assert late.result(300.0) is True
    turn = dispatcher.line.join()
    assert not turn.done()
    dispatcher.line.leave(late)  # it has a worker, and nobody waits for it any more
    assert turn.result(0) is True
    assert not dispatcher.line.reserve()


def test_the_line_and_the_queue_take_turns(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)  # a look at the queue may have the worker for a moment
    turns = [dispatcher.line.join() for _ in range(2)]
    for name in ("queued 1", "queued 2"):
        store.meshes.add(NewMesh(id=name, spec=SPEC))
    dispatcher.wake()
    for taken in ((1, 0), (1, 1), (2, 1), (2, 2)):
        dispatcher.line.release()  # one worker is free
        until(lambda now=taken: (sum(turn.done() for turn in turns), len(engine.tasks)) == now)
        time.sleep(0.05)
        assert (sum(turn.done() for turn in turns), len(engine.tasks)) == taken


def test_a_backlog_in_the_queue_delays_nobody(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    add_backlog(store, 1000, "a", SPEC)
    dispatcher.wake()
    dispatcher.line.release()
    dispatcher.line.release()
    assert until(lambda: len(engine.tasks) == 2)
    add_backlog(store, 1, "b", SPEC)
    add_backlog(store, 1, "c", SPEC)
    for number, name in enumerate(("a-0", "a-1", "b-0", "c-0")):
        _finish(store, engine, number, name)
        assert until(lambda now=number + 3: len(engine.tasks) == now)
    started = [row.id for row in store.meshes.page(status="running", key_id=None)]
    assert sorted(started) == ["a-2", "a-3"]
    assert all(status(store, name) == "succeeded" for name in ("a-0", "a-1", "b-0", "c-0"))


def test_a_backlog_delays_nobody_at_any_of_several_services(database_url: str) -> None:
    store, engines = Store(database_url), {"one": Patient(), "two": Patient()}
    store.prepare()
    dispatchers = [
        Dispatcher(name, store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
        for name, engine in engines.items()
    ]
    add_backlog(store, 1000, "a", SPEC)
    for dispatcher in dispatchers:
        dispatcher.start(alone=False)
    until(lambda: all(len(engine.tasks) == 2 for engine in engines.values()))
    add_backlog(store, 2, "b", SPEC)
    for name, engine in engines.items():
        store.queue.finish(min(store.queue.find_held(name), key=lambda claim: int(claim.mesh_id.removeprefix("a-"))))
        engine.tasks[0].set_result(Ending(status="succeeded"))
        until(lambda tasks=engine.tasks: len(tasks) == 3)
    assert store.queue.find_waiting().running == {"a": 2, "b": 2}
    for dispatcher in dispatchers:
        dispatcher.stop()
    store.close()


def test_a_request_that_waits_and_a_backlog_take_turns(dispatcher: Dispatcher, store: Store, engine: Patient) -> None:
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    add_backlog(store, 1000, "a", SPEC)
    dispatcher.wake()
    turns = [dispatcher.line.join("b") for _ in range(3)]
    also = dispatcher.line.join("a")  # of the key whose meshes wait in the queue
    order = list[str]()
    for number in range(1, 7):
        dispatcher.line.release()  # one worker is free
        until(lambda now=number: sum(turn.done() for turn in (*turns, also)) + len(engine.tasks) == now)
        states = {"b": sum(turn.done() for turn in turns), "also": int(also.done()), "a": len(engine.tasks)}
        order.append(next(name for name, count in states.items() if count > order.count(name)))
    assert order == ["b", "also", "b", "a", "b", "a"]


def test_a_line_has_an_end_and_ends_with_the_service(store: Store, engine: Patient) -> None:
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    dispatcher.start(alone=True)
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    turns = [dispatcher.line.join() for _ in range(64)]
    assert dispatcher.line.join().result(0) is False
    dispatcher.stop()
    assert {turn.result(0) for turn in turns} == {False}
    assert dispatcher.line.join().result(0) is False


def test_who_stands_in_line_too_long_goes_into_the_queue(dispatcher: Dispatcher) -> None:
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    assert asyncio.run(dispatcher.line.obtain(seconds=0.05)) is False
    threading.Timer(0.05, dispatcher.line.release).start()
    assert asyncio.run(dispatcher.line.obtain(seconds=300.0)) is True
    assert not dispatcher.line.reserve()  # nobody is left in the line, and no worker was lost
    dispatcher.line.release()
    until(dispatcher.line.reserve)


def test_a_task_that_is_no_mesh_has_its_worker_until_it_ends(dispatcher: Dispatcher) -> None:
    """Also where it fails; and its key counts as one with a running task."""
    line, tasks = dispatcher.line, [Future[Any]() for _ in range(2)]
    for task in tasks:
        until(line.reserve)
        line.occupy(task, "a")
    assert not line.reserve("a")
    waiting = {key: line.join(key) for key in ("a", "b")}
    tasks[0].set_exception(WorkerLostError("it died"))
    assert waiting["b"].result(300.0) is True
    assert not waiting["a"].done()
    tasks[1].set_result(b"")
    assert waiting["a"].result(300.0) is True
    assert not line.reserve()
    for _ in waiting:
        line.release()
    until(line.reserve)


FINISHED = FinishedMesh(outcome=Outcome(result={}), contents={}, ending=Ending(status="succeeded"), seconds=1.0)


def _begin(dispatcher: Dispatcher, store: Store) -> Future[Any]:
    """A mesh of a reserved worker."""
    until(dispatcher.line.reserve)
    store.meshes.add(NewMesh(id="a", spec=SPEC), lease=dispatcher.lease)
    return dispatcher.begin(Claim("a", 1), MESH_INPUT)


def test_a_worker_is_free_while_its_mesh_is_written_and_nobody_takes_the_mesh(
    dispatcher: Dispatcher, store: Store, engine: Patient, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, keep = threading.Event(), dispatcher_module.store_finished

    def late(*arguments: Any) -> str | None:
        assert go_on.wait(300.0)
        return keep(*arguments)

    monkeypatch.setattr(dispatcher_module, "store_finished", late)
    ended = _begin(dispatcher, store)
    engine.tasks[0].set_result(FINISHED)
    until(dispatcher.line.reserve)
    until(dispatcher.line.reserve)
    for _ in range(3):
        dispatcher._renew_leases()
    assert not ended.done()
    assert status(store, "a") == "running"
    go_on.set()
    ending = ended.result(300.0)
    assert (ending.status, [*ending.laps]) == ("succeeded", ["commit"])
    assert status(store, "a") == "succeeded"
    assert dispatcher._storing == set()


@pytest.mark.parametrize(
    ("fault", "name", "end"),
    [
        (OSError(errno.ENOSPC, "full"), "storage-full", "failed"),
        (
            OperationalError("", {}, sqlite3.OperationalError("gone"), connection_invalidated=True),
            "unavailable",
            "again",
        ),
    ],
)
def test_a_mesh_that_cannot_be_written_says_so_and_does_not_run_for_ever(
    dispatcher: Dispatcher,
    store: Store,
    engine: Patient,
    monkeypatch: pytest.MonkeyPatch,
    fault: Exception,
    name: str,
    end: str,
) -> None:
    def fail(*_: Any) -> None:
        raise fault

    monkeypatch.setattr(dispatcher_module, "store_finished", fail)
    ended = _begin(dispatcher, store)
    engine.tasks[0].set_result(FINISHED)
    problem = ended.exception(300.0)
    assert isinstance(problem, Problem)
    assert problem.name == name
    if end == "failed":
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert row.error["type"] == "/problems/storage-full"
    else:
        until(lambda: len(engine.tasks) == 2)  # another attempt
    until(lambda: dispatcher._storing == set())


def test_what_is_finished_as_the_service_stops_waits_again(store: Store, engine: Patient) -> None:
    dispatcher = Dispatcher("me", store, engine, lambda *_: (print, ()), Rules(poll=0.01), lambda _: None)
    dispatcher.start(alone=True)
    ended = _begin(dispatcher, store)
    dispatcher.stop()
    engine.tasks[0].set_result(FINISHED)
    assert isinstance(ended.exception(0), EngineError)
    assert status(store, "a") == "queued"
