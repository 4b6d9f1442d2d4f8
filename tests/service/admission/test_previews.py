"""Previews and their workers: a worker is free again however a preview ends, and nobody waits for ever."""

from __future__ import annotations

import asyncio
import json
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from equimesh_service import Settings
from equimesh_service.admission import previews as module
from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import ANYONE
from equimesh_service.admission.previews import PreviewAdmission, Previews
from equimesh_service.dispatch.wakeups import CheckThreads
from equimesh_service.dispatch.worker_line import SideWorkers, WorkerLine
from equimesh_service.engine.port import Health
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError, WorkerLostError
from equimesh_service.files.address import files_address
from equimesh_service.problems.problem import Problem, problem_at
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.store import Store
from equimesh_service.worker.job import Storage
from service.conftest import small, until


class OneWorker:
    """An engine of one worker whose task ends when a test ends it, as a real one would, with what it was given."""

    def __init__(self) -> None:
        self.tasks: list[Future[Any]] = []
        self.given: list[tuple[Any, ...]] = []
        self.canceled: list[Future[Any]] = []
        self.closed = False

    def submit(self, function: Any, *arguments: Any, time_limit: float | None = None) -> Future[Any]:
        if self.closed:
            raise EngineError("the engine is closed")
        task = Future[Any]()
        task.set_running_or_notify_cancel()
        self.tasks.append(task)
        self.given.append((function, pickle.loads(pickle.dumps(arguments)), time_limit))
        return task

    def cancel(self, task: Future[Any]) -> None:
        self.canceled.append(task)
        task.set_exception(CancelledError())

    def health(self) -> Health:
        return Health(ready=True, workers=1)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def engine() -> OneWorker:
    return OneWorker()


@contextmanager
def opened(folder: Path, engine: OneWorker) -> Iterator[Callable[[CheckThreads], Previews]]:
    """Makes previews in a running event loop."""
    settings = Settings(data_dir=folder, preview_seconds=3.0)
    storage = Storage(settings.database, files_address(settings))
    store = Store(settings.database)
    store.prepare()
    line = WorkerLine(engine, lambda: (), lambda: None)
    line.queue_is_empty = True

    def make(threads: CheckThreads) -> Previews:
        admission = Admission(
            settings,
            store,
            BlobFiles(store.database, storage.address.open()),
            SideWorkers(OneWorker()),
            threads.while_waiting,
        )
        return Previews(settings, storage, PreviewAdmission.of(admission), threads, engine, line)

    try:
        yield make
    finally:
        store.close()


def drawn(
    folder: Path,
    engine: OneWorker,
    during: Callable[[Previews, asyncio.Task[Any]], Any],
    *,
    spec: dict[str, Any] | None = None,
    has_left: bool = False,
) -> Any:
    """What becomes of a preview that ``during`` looks at in a thread; then the worker must be free."""

    async def answer_left() -> bool:
        return has_left

    async def run() -> Any:
        previews = make(CheckThreads())
        body = json.dumps(spec or small()).encode()
        task = asyncio.create_task(previews.draw(body, None, ANYONE, frames=True, has_left=answer_left))
        looking = asyncio.create_task(asyncio.to_thread(during, previews, task))
        outcome = (await asyncio.gather(task, return_exceptions=True))[0]
        await looking
        assert previews.line.reserve()  # one worker is free
        assert not previews.line.reserve()  # and no more than one
        return outcome

    with opened(folder, engine) as make:
        return asyncio.run(run())


def test_a_worker_draws_and_is_free_then(tmp_path: Path, engine: OneWorker) -> None:
    def end(previews: Previews, _: asyncio.Task[Any]) -> None:
        until(lambda: engine.tasks)
        assert not previews.line.reserve()  # it is occupied
        engine.tasks[0].set_result(b"drawing")

    assert drawn(tmp_path, engine, end) == b"drawing"
    ((function, (preview,), limit),) = engine.given
    assert (function, limit, preview.seconds) == (module.draw_preview, 4.0, 3.0)
    assert (preview.frames, preview.built.problem.grid.shape) == (True, (8, 9))


@pytest.mark.parametrize(
    ("error", "name", "words"),
    [
        (TimeLimitError("the time limit was reached"), "time-limit", "within 3 s (EQUIMESH_PREVIEW_SECONDS)"),
        (MemoryLimitError("the memory limit was reached"), "memory-limit", "4096 MiB"),
        (WorkerLostError("the worker died"), "unavailable", "the worker died"),
        (CancelledError(), "unavailable", "its worker does not answer"),
        (problem_at("/monitor/u/expression", "no"), "invalid-input", "/monitor/u"),
    ],
    ids=["time", "memory", "worker", "cancelled", "input"],
)
def test_a_preview_that_fails_says_why(
    tmp_path: Path, engine: OneWorker, error: Exception, name: str, words: str
) -> None:
    def end(*_: Any) -> None:
        until(lambda: engine.tasks)
        engine.tasks[0].set_exception(error)

    outcome = drawn(tmp_path, engine, end, spec=small(monitor={"u": "x*y"}))
    assert isinstance(outcome, Problem)
    assert outcome.name == name
    assert words in outcome.detail
    if name == "time-limit":
        assert "POST /v1/meshes" in outcome.body()["remedy"]
    if name == "invalid-input":
        assert [complaint.pointer for complaint in outcome.errors] == ["/monitor/u"]  # as it was sent


def test_a_worker_that_never_answers_is_given_up(
    tmp_path: Path, engine: OneWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MAX_REPORT_SECONDS", -3.8)
    outcome = drawn(tmp_path, engine, lambda *_: None)
    assert isinstance(outcome, Problem)
    assert outcome.name == "unavailable"
    assert engine.canceled == engine.tasks


def test_who_has_left_takes_no_worker(tmp_path: Path, engine: OneWorker) -> None:
    assert drawn(tmp_path, engine, lambda *_: None, has_left=True) is None
    assert engine.tasks == []


def test_a_request_that_is_given_up_leaves_its_worker_until_the_task_ends(tmp_path: Path, engine: OneWorker) -> None:
    def leave(previews: Previews, task: asyncio.Task[Any]) -> None:
        until(lambda: engine.tasks)
        task.get_loop().call_soon_threadsafe(task.cancel)
        until(task.done)
        assert not previews.line.reserve()
        assert engine.canceled == []
        engine.tasks[0].set_result(b"for no one")

    assert isinstance(drawn(tmp_path, engine, leave), asyncio.CancelledError)


def test_without_a_worker_the_answer_comes_soon_and_says_when_to_try_again(
    tmp_path: Path, engine: OneWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_LINE_SECONDS", 0.05)

    async def run() -> Problem:
        previews = make(CheckThreads())
        assert previews.line.reserve()
        with pytest.raises(Problem) as caught:
            await previews.draw(json.dumps(small()).encode(), None, ANYONE, frames=False, has_left=stays)
        previews.line.release()
        assert previews.line.reserve()
        return caught.value

    async def stays() -> bool:
        return False

    with opened(tmp_path, engine) as make:
        problem = asyncio.run(run())
    assert (problem.name, problem.headers["Retry-After"]) == ("workers-busy", "1")
    assert engine.tasks == []


def test_a_closed_engine_leaves_the_worker_free(tmp_path: Path, engine: OneWorker) -> None:
    engine.close()
    outcome = drawn(tmp_path, engine, lambda *_: None)
    assert isinstance(outcome, Problem)
    assert outcome.name == "unavailable"


def test_the_monitor_of_a_preview_that_takes_long_to_check_is_left_to_the_worker(
    tmp_path: Path, engine: OneWorker
) -> None:
    """The side workers of this service never answer."""

    def end(*_: Any) -> None:
        until(lambda: engine.tasks)
        engine.tasks[0].set_result(b"")

    spec = small(monitor={"kind": "curvature", "u": "x*x*y", "smoothing": 0.1}, parts=None)
    assert drawn(tmp_path, engine, end, spec=spec) == b""
    ((_, (preview,), _),) = engine.given
    assert preview.built is None
