"""Meshes that are not kept and their workers: a worker is free again however one ends, and nobody waits for ever."""

from __future__ import annotations

import asyncio
import io
import json
import pickle
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_service import Settings
from equimesh_service.admission import unstored as module
from equimesh_service.admission.callers import ANYONE
from equimesh_service.admission.computation import Computation, ComputationResult, Request, answer, compute
from equimesh_service.admission.unstored import UnstoredMeshes
from equimesh_service.dispatch.worker_line import WorkerLine
from equimesh_service.engine.port import Health, PackedCall, open_outcome, pack_outcome
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError, WorkerLostError
from equimesh_service.files.address import files_address
from equimesh_service.problems.problem import Problem, problem_at
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Claim, Ending, Lease, NoMesh
from equimesh_service.store.store import Store
from equimesh_service.wire.body import JSON
from equimesh_service.worker.job import DRAWING, Storage
from service.conftest import small, until
from service.requests import npz


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


BODY = json.dumps(small()).encode()
ANSWER = ComputationResult(content=b"answer", certificate="{}", ending=Ending(status="succeeded"))


def opened(folder: Path, engine: OneWorker) -> UnstoredMeshes:
    settings = Settings(data_dir=folder, preview_seconds=3.0)
    line = WorkerLine(engine, lambda: (), lambda: None)
    line.queue_is_empty = True
    return UnstoredMeshes(settings, Storage(settings.database, files_address(settings)), engine, line)


async def stays() -> None:
    """A caller who waits."""
    await asyncio.Event().wait()


async def left() -> None:
    """A caller who has left."""


def computed(
    folder: Path,
    engine: OneWorker,
    during: Callable[[UnstoredMeshes, asyncio.Task[Any]], Any],
    *,
    format: str | None = DRAWING,
    leaves: Callable[[], Any] = stays,
) -> Any:
    """What becomes of a request that ``during`` looks at in a thread; then the worker must be free."""

    async def run() -> Any:
        meshes = opened(folder, engine)
        answer = meshes.compute(BODY, JSON, ANYONE, format=format, seconds=3.0, frames=True, leaves=leaves)
        task = asyncio.create_task(answer)
        looking = asyncio.create_task(asyncio.to_thread(during, meshes, task))
        outcome = (await asyncio.gather(task, return_exceptions=True))[0]
        await looking
        assert meshes.line.reserve()  # one worker is free
        assert not meshes.line.reserve()  # and no more than one
        return outcome

    return asyncio.run(run())


def test_a_free_worker_is_for_the_queue_unless_that_is_empty(engine: OneWorker) -> None:
    looks: list[bool] = []
    line = WorkerLine(engine, lambda: (), lambda: looks.append(True))
    for line.queue_is_empty in (True, False):
        with line.lock:
            line._reserved += 1
        line.release()
    assert looks == [True]


def test_a_worker_gets_the_request_as_it_came_and_is_free_then(tmp_path: Path, engine: OneWorker) -> None:
    def end(meshes: UnstoredMeshes, _: asyncio.Task[Any]) -> None:
        until(lambda: engine.tasks)
        assert not meshes.line.reserve()  # it is occupied
        engine.tasks[0].set_result(ANSWER)

    assert computed(tmp_path, engine, end) == ANSWER
    ((function, (task,), limit),) = engine.given
    assert (function, limit, task.seconds) == (module.COMPUTE, 4.0, 3.0)
    assert (task.frames, task.body, task.content_type) == (True, BODY, JSON)


@pytest.mark.parametrize(
    ("format", "error", "name", "words"),
    [
        (DRAWING, TimeLimitError("the time limit was reached"), "time-limit", "within 3 s (EQUIMESH_PREVIEW_SECONDS)"),
        ("npz", TimeLimitError("the time limit was reached"), "time-limit", "within 3 s (EQUIMESH_MAX_WAIT)"),
        (None, MemoryLimitError("the memory limit was reached"), "memory-limit", "4096 MiB"),
        (None, WorkerLostError("the worker died"), "unavailable", "the worker died"),
        (None, CancelledError(), "unavailable", "its worker does not answer"),
        (None, problem_at("/monitor/u", "no"), "invalid-input", "/monitor/u"),
    ],
    ids=["preview", "time", "memory", "worker", "cancelled", "input"],
)
def test_a_computation_that_fails_says_why(
    tmp_path: Path, engine: OneWorker, format: str | None, error: Exception, name: str, words: str
) -> None:
    def end(*_: Any) -> None:
        until(lambda: engine.tasks)
        engine.tasks[0].set_exception(error)

    outcome = computed(tmp_path, engine, end, format=format)
    assert isinstance(outcome, Problem)
    assert outcome.name == name
    assert words in outcome.detail
    if name == "time-limit":
        assert "POST /v1/meshes" in outcome.body()["remedy"]


def test_a_worker_that_never_answers_is_given_up(
    tmp_path: Path, engine: OneWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MAX_REPORT_SECONDS", -3.8)
    outcome = computed(tmp_path, engine, lambda *_: None)
    assert isinstance(outcome, Problem)
    assert outcome.name == "unavailable"
    assert engine.canceled == engine.tasks


def test_who_has_left_takes_no_worker(tmp_path: Path, engine: OneWorker) -> None:
    async def run() -> Any:
        meshes = opened(tmp_path, engine)
        assert meshes.line.reserve()
        answer = meshes.compute(BODY, JSON, ANYONE, format=None, seconds=3.0, leaves=left)
        task = asyncio.create_task(answer)
        await asyncio.sleep(0.05)
        meshes.line.release()
        return await task

    assert asyncio.run(run()) is None
    assert engine.tasks == []


def test_the_work_ends_soon_after_its_caller_has_left(tmp_path: Path, engine: OneWorker) -> None:
    gone = asyncio.Event()

    def leave(_: UnstoredMeshes, task: asyncio.Task[Any]) -> None:
        until(lambda: engine.tasks)
        task.get_loop().call_soon_threadsafe(gone.set)

    async def leaves() -> None:
        await gone.wait()

    assert computed(tmp_path, engine, leave, leaves=leaves) is None
    assert engine.canceled == engine.tasks


def test_the_work_of_a_request_that_is_given_up_ends(tmp_path: Path, engine: OneWorker) -> None:
    def give_up(_: UnstoredMeshes, task: asyncio.Task[Any]) -> None:
        until(lambda: engine.tasks)
        task.get_loop().call_soon_threadsafe(task.cancel)

    assert isinstance(computed(tmp_path, engine, give_up), asyncio.CancelledError)
    assert engine.canceled == engine.tasks


def test_without_a_worker_the_answer_comes_soon_and_says_when_to_try_again(
    tmp_path: Path, engine: OneWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_LINE_SECONDS", 0.05)

    async def run() -> Problem:
        meshes = opened(tmp_path, engine)
        assert meshes.line.reserve()
        with pytest.raises(Problem) as caught:
            await meshes.compute(BODY, JSON, ANYONE, format=None, seconds=3.0, leaves=stays)
        meshes.line.release()
        assert meshes.line.reserve()
        return caught.value

    problem = asyncio.run(run())
    assert (problem.name, problem.headers["Retry-After"]) == ("workers-busy", "1")
    assert engine.tasks == []


def test_a_closed_engine_leaves_the_worker_free(tmp_path: Path, engine: OneWorker) -> None:
    engine.close()
    outcome = computed(tmp_path, engine, lambda *_: None)
    assert isinstance(outcome, Problem)
    assert outcome.name == "unavailable"


AXIS = np.linspace(0.0, 1.0, 6)


def task(folder: Path, spec: dict[str, Any], **more: Any) -> Computation:
    settings = Settings(data_dir=folder)
    folder.joinpath("files").mkdir(exist_ok=True)
    store = Store(settings.database)
    store.prepare()
    store.close()
    known: dict[str, Any] = {
        "body": json.dumps(spec).encode(),
        "content_type": "application/json",
        "format": DRAWING,
        "seconds": 600.0,
        **more,
    }
    return Computation(
        caller=ANYONE, settings=settings, storage=Storage(settings.database, files_address(settings)), **known
    )


def files(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob("*") if path.is_file() and "sqlite" not in path.name]


def test_samples_of_the_request_leave_no_file(tmp_path: Path) -> None:
    spec = small(monitor={"kind": "arc_length", "u": {"samples": "upload"}})
    body = npz(spec=json.dumps(spec), x=AXIS, y=AXIS, values=np.add.outer(AXIS**2, AXIS))
    computed = compute(task(tmp_path, spec, body=body, content_type="application/x-npz"))
    with np.load(io.BytesIO(computed.content)) as drawing:
        assert drawing["u"][-1, -1] == pytest.approx(2.0)
    assert (computed.ending.uploads, files(tmp_path)) == (1, [])


def test_a_task_crosses_to_a_cluster(tmp_path: Path) -> None:
    """As the engine of a cluster sends it: as bytes."""
    good = PackedCall.of(compute, task(tmp_path, small(schwarz={}), frames=True))
    computed: ComputationResult = open_outcome(pack_outcome(good))
    with np.load(io.BytesIO(computed.content)) as drawing:
        frames = json.loads(drawing["document"].tobytes())["frames"]
        assert drawing["frames_x"].shape == (len(frames), 8, 9)
    wrong = small(monitor={"kind": "curvature", "u": "sqrt(x - 2)", "smoothing": 0.1})
    with pytest.raises(Problem, match="not finite"):
        open_outcome(pack_outcome(PackedCall.of(compute, task(tmp_path, wrong))))


def test_only_the_service_refuses_for_meshes_in_flight(tmp_path: Path) -> None:
    """It knows which of them are still there."""
    sent = task(tmp_path, small())
    of_task = {name: getattr(sent, name) for name in ("content_type", "body", "caller", "settings", "storage")}
    quota = Quota(queued=1, points=0, in_flight=("gone",))
    known: dict[str, Any] = {"format": None, "key": None, "reuse": False, "quota": quota}
    end = answer(Request(**of_task, **known, claim=Claim("m", 1), lease=Lease(owner="me", seconds=60.0)))
    assert isinstance(end, NoMesh)
    assert (end.error, end.admitted.spec["grid"]) == (None, small()["grid"])


def test_a_solve_ends_itself_at_its_limit(tmp_path: Path) -> None:
    """The worker lives on, which the engine would have to kill."""
    with pytest.raises(TimeLimitError):
        compute(task(tmp_path, small(schwarz={}), seconds=0.0))


def test_the_problem_of_a_failed_solve_is_the_answer_for_its_file(tmp_path: Path) -> None:
    classical = {"transmission": {"kind": "classical"}, "max_iterations": 2, "tolerance": 1e-10, "fallback": False}
    said = json.loads(compute(task(tmp_path, small(schwarz=classical), format=None)).content)
    assert (said["status"], said["error"]["type"]) == ("failed", "/problems/not-converged")
    with pytest.raises(Problem) as caught:
        compute(task(tmp_path, small(schwarz=classical), format="vtu"))
    assert caught.value.name == "not-converged"


def test_what_a_preview_costs(tmp_path: Path) -> None:
    """A drawing is small next to what it draws."""
    spec = small(monitor={"kind": "arc_length", "u": "tanh(8*(x + y/2 - 0.75))"}, grid={"n_xi": 65, "n_eta": 65})
    assert len(compute(task(tmp_path, spec)).content) < 64 * 65 * 65 + 20_000
