"""Side workers take keys in turn: the waiting tasks of one key do not delay the others."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from equimesh_service.dispatch.worker_line import SideWorkers
from equimesh_service.engine.port import Health
from equimesh_service.errors import EngineError, WorkerLostError
from service.conftest import small
from service.guarded import Guarded


class ByHand:
    """An engine of three workers whose tasks end when the test ends them."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.running: dict[str, Future[Any]] = {}
        self.state = "open"

    def submit(self, function: Callable[..., Any], *arguments: Any, time_limit: float | None = None) -> Future[Any]:  # noqa: ARG002
        if self.state == "closed":
            raise EngineError("the engine is closed")
        task: Future[Any] = Future()
        if self.state == "broken":
            task.set_exception(WorkerLostError("there are no workers"))
        self.begun.append(arguments[0])
        self.running[arguments[0]] = task
        return task

    def end(self, name: str) -> None:
        self.running.pop(name).set_result(name.upper())

    def cancel(self, task: Future[Any]) -> None:
        task.cancel()

    def health(self) -> Health:
        return Health(ready=True, workers=3)

    def close(self) -> None:
        self.state = "closed"
        for task in self.running.values():
            task.cancel()


def test_keys_take_turns() -> None:
    engine = ByHand()
    side_workers = SideWorkers(engine)
    first = [side_workers.submit("a", print, f"a{number}") for number in range(6)]
    assert engine.begun == ["a0", "a1"]
    second = [side_workers.submit("b", print, f"b{number}") for number in range(3)]
    third = side_workers.submit("c", print, "c0")
    assert engine.begun == ["a0", "a1", "b0"]
    while engine.running:
        engine.end(next(iter(engine.running)))
    # The first task of a late key begins at the next end, and no key has two while others wait.
    assert engine.begun[:4] == ["a0", "a1", "b0", "c0"]
    assert engine.begun[4:8] == ["a2", "b1", "a3", "b2"]
    assert [task.result(0) for task in (*second, third)] == ["B0", "B1", "B2", "C0"]
    assert [task.result(0) for task in first] == [f"A{number}" for number in range(6)]


def test_tasks_of_one_key_that_never_end_hold_no_other_key_back() -> None:
    engine = ByHand()
    side_workers = SideWorkers(engine)
    for number in range(9):
        side_workers.submit("a", print, f"a{number}")
    for name in ("b0", "c0", "b1"):
        task = side_workers.submit(name[0], print, name)
        assert engine.begun[-1] == name
        engine.end(name)
        assert task.result(0) == name.upper()
    assert engine.begun[:2] == ["a0", "a1"]
    assert len(engine.running) == 2


def test_callers_without_a_key_have_all_workers() -> None:
    engine = ByHand()
    side_workers = SideWorkers(engine)
    for number in range(4):
        side_workers.submit("", print, f"{number}")
    assert engine.begun == ["0", "1", "2"]


def test_no_task_is_forgotten_when_the_workers_are() -> None:
    engine = ByHand()
    side_workers = SideWorkers(engine)
    tasks = [side_workers.submit("a", print, f"a{number}") for number in range(3000)]
    engine.state = "broken"
    engine.end("a0")
    assert tasks[0].result(0) == "A0"
    assert isinstance(tasks[2999].exception(0), WorkerLostError)
    engine.state = "open"
    waiting = [side_workers.submit("b", print, f"b{number}") for number in range(4)]
    assert engine.begun[-2:] == ["b0", "b1"]  # with a1: there are as many places as before
    side_workers.close()
    assert all(task.exception(0) is not None for task in (tasks[1], *waiting))


def test_samples_and_files_take_the_turns_of_their_key(
    guarded_service: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    row, secret = guarded_service.key("write")
    keys, submit = list[str](), SideWorkers.submit

    def note(side_workers: SideWorkers, key_id: str, *task: Any, **limits: Any) -> Future[Any]:
        keys.append(key_id)
        return submit(side_workers, key_id, *task, **limits)

    monkeypatch.setattr(SideWorkers, "submit", note)
    scattered = {"points": [[i / 4, j / 4] for i in range(5) for j in range(5)], "values": [0.1 * k for k in range(25)]}
    with guarded_service.having(secret) as client:
        # Without a wait: a worker reads the samples of a request that waits.
        posted = client.post("/v1/meshes", json=small(monitor={"kind": "arc_length", "u": {"scattered": scattered}}))
        mesh = client.get(posted.headers["Location"], params={"wait": 300}).json()
        assert mesh["status"] == "succeeded", mesh["error"]
        samples = len(keys)
        assert samples >= 1
        assert client.get(mesh["links"]["plot"]).status_code == 200
        assert len(keys) == samples + 1
    assert {*keys} == {row.id}
