"""Side workers take keys in turn: what one has waiting does not hold up the others."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_service import Settings
from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import ANYONE
from equimesh_service.dispatch.side_workers import SideWorkers
from equimesh_service.engine.port import Health
from equimesh_service.errors import EngineError, WorkerLostError
from equimesh_service.service import Service
from equimesh_service.telemetry import log_context
from service.conftest import small


class ByHand:
    """An engine of two workers, whose tasks end when the test says so."""

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
        return Health(ready=True, workers=2)

    def close(self) -> None:
        self.state = "closed"
        for task in self.running.values():
            task.cancel()


def test_keys_take_turns() -> None:
    engine = ByHand()
    side_workers = SideWorkers(engine)
    first = [side_workers.submit("a", print, f"a{number}") for number in range(6)]
    second = [side_workers.submit("b", print, f"b{number}") for number in range(2)]
    third = side_workers.submit("c", print, "c0")
    assert engine.begun == ["a0", "a1"]
    for name in ("a1", "a0", "b0", "c0", "a2", "b1"):
        engine.end(name)
        assert len(engine.running) == 2
    # Whoever came late does not wait for all that was there before.
    assert engine.begun == ["a0", "a1", "a2", "b0", "c0", "a3", "b1", "a4"]
    assert [task.result(0) for task in (*second, third)] == ["B0", "B1", "C0"]
    for name in ("a3", "a4", "a5"):
        engine.end(name)
    assert [task.result(0) for task in first] == [f"A{number}" for number in range(6)]


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
    assert engine.begun[-1] == "b0"  # beside a1: there are as many places as before
    side_workers.close()
    assert all(task.exception(0) is not None for task in (tasks[1], *waiting))


class Asked(Exception):
    """The side workers were asked."""


def asked_by() -> tuple[list[str], Any]:
    """The keys that tasks are submitted for, and the side workers."""
    keys: list[str] = []

    def submit(key_id: str, *_: Any, time_limit: float) -> Future[Any]:  # noqa: ARG001
        keys.append(key_id)
        raise Asked

    return keys, SimpleNamespace(submit=submit)


@pytest.mark.anyio
async def test_samples_and_files_take_the_turns_of_who_asks() -> None:
    keys, side_workers = asked_by()
    scattered = {"points": [[i / 4, j / 4] for i in range(5) for j in range(5)], "values": [0.1 * k for k in range(25)]}
    spec = json.dumps(small(monitor={"u": {"scattered": scattered}})).encode()
    nowhere: Any = None
    admission = Admission(
        Settings(),
        nowhere,
        nowhere,
        side_workers,
        lambda key_id: nullcontext(keys.append(f"waiting {key_id}")),
        OrderedDict(),
    )
    store = SimpleNamespace(meshes=SimpleNamespace(artifact=lambda *_: None))
    service: Any = SimpleNamespace(
        store=store, storage=None, exporting={}, side_workers=side_workers, settings=Settings()
    )
    with log_context.enter(log_context.LogContext(key_id="k")):
        with pytest.raises(Asked):
            admission.receive(spec, None, ANYONE)
        with pytest.raises(Asked):
            await Service.artifact(service, "m-1", "plot:mesh:svg")
    assert keys == ["waiting k", "k", "k"]
