"""The warm-up of processes, the loops of rare kinds, and what a worker of a cluster reaches."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from equimesh.numerics.compiled import Compiled
from equimesh_service.errors import EngineError
from equimesh_service.files.address import FilesAddress
from equimesh_service.worker import rare_loops, warmth
from equimesh_service.worker import reach as module
from equimesh_service.worker.job import Storage
from equimesh_service.worker.rare_loops import LoopCount, RareLoops
from equimesh_service.worker.reach import Reach
from service.conftest import until

# A process as those of workers, forked from one that has imported `warm_fork`. There is one small problem of each kind
# in it: prints each loop that is made or loaded for it.
EVERY_KIND = """
import os
import equimesh_service.worker.warm_fork
from equimesh_service.worker import warmth
assert len(os.listdir("/proc/self/task")) == 1, "a process with threads must not be forked"
child = os.fork()
if child:
    raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
warmth.warm_up = None  # a second one would fail
warmth.warm_up_once()
import numpy as np
import equimesh as em
from equimesh.numerics import compiled
from equimesh.testing.geometries import disc

print(compiled.count_compiled())
ready = {loop: set(loop.overloads) for loop in compiled._loops}
grid = em.Grid(n_xi=21, n_eta=17)
u, of_blocks = em.Expression("tanh(30*(x - 0.4 - 0.2*sin(3*y)))"), em.Expression("tanh(9*(x - y))")
axis = np.linspace(0.0, 1.0, 40)
samples = em.GridSamples(x=axis, y=axis, values=np.tanh(20.0 * np.subtract.outer(axis, axis)))
places = np.vstack([np.random.default_rng(1).random((300, 2)), np.mgrid[0:2, 0:2].reshape(2, -1).T])
scattered = em.ScatteredSamples(points=places, values=np.tanh(9.0 * (places[:, 0] - places[:, 1])))
domain = disc(300)
problems = [
    *(em.Problem(monitor=em.Auto(u=field), grid=grid) for field in (u, samples, scattered)),
    em.Problem(monitor=em.Auto(u=u, norm="h1"), grid=grid),
    em.Problem(monitor=em.LeastError(u=u, orthogonality=50.0), grid=grid),
    em.Problem(monitor=em.LeastError(u=u, cells="triangle"), grid=grid),
    em.Problem(monitor=em.LeastError(u=u), grid=grid, domain=em.AnnulusSector(closed=True)),
    em.Problem(monitor=em.ArcLength(u=u), grid=grid),
    *(em.Problem(monitor=em.Auto(u=of_blocks, norm=norm), domain=domain) for norm in ("l2", "h1")),
    em.Problem(monitor=em.LeastError(u=of_blocks, orthogonality=40.0), domain=domain),
    em.Problem(monitor=em.LeastError(u=of_blocks, cells="triangle"), domain=domain),
]
for problem in problems:
    solution = em.solve(problem, threads=1, check=False)
    solution.data(), solution.certificate, solution.quality, solution.interpolation
mesh, blocks = em.Mesh.uniform(grid), domain.mesh
for norm in ("l2", "h1"):
    em.adapt_round(mesh, np.tanh(9.0 * (mesh.x - mesh.y)), norm=norm)
    em.adapt_round(blocks, of_blocks.evaluate(*blocks.points.T)[0], domain, norm=norm)
values = em.MeshValues(np.round(mesh.x + mesh.y), transfer="conservative")
em.transfer(mesh, {"u": values, "v": mesh.x}, em.Mesh(mesh.x**1.5, mesh.y))
for loop, before in ready.items():
    for signature in set(loop.overloads) - before:
        print(loop.__module__, loop.__name__, signature)
"""


# The most frequent problems after the part of the warm-up for them: prints each loop that is made or loaded for one.
BASIC_KINDS = """
import numpy as np
import equimesh as em
from equimesh.numerics import compiled
from equimesh.warm_up import warm_up_basics

warm_up_basics()
ready = {loop: set(loop.overloads) for loop in compiled._loops}
print(sum(bool(found) for found in ready.values()), len(ready))
grid = em.Grid(n_xi=21, n_eta=17)
u, axis = em.Expression("tanh(30*(x - 0.4 - 0.2*sin(3*y)))"), np.linspace(0.0, 1.0, 40)
samples = em.GridSamples(x=axis, y=axis, values=np.tanh(20.0 * np.subtract.outer(axis, axis)))
monitors = [kind(u=field) for kind in (em.ArcLength, em.Auto, em.LeastError) for field in (u, samples)]
problems = [
    *(em.Problem(monitor=monitor, grid=grid) for monitor in monitors),
    em.Problem(monitor=monitors[0], grid=em.Grid(n_xi=200, n_eta=200)),
]
for problem in problems:
    solution = em.solve(problem, threads=1, check=False)
    solution.data(), solution.certificate, solution.quality, solution.interpolation
for loop, before in ready.items():
    for signature in set(loop.overloads) - before:
        print(loop.__module__, loop.__name__, signature)
"""


def run(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **single, **variables}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300)


def test_a_process_warms_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(warmth, "_is_warm", False)
    monkeypatch.setattr(warmth, "warm_up", lambda: calls.append(1))
    warmth.warm_up_once()
    warmth.warm_up_once()
    assert calls == [1]


@pytest.mark.parametrize(("count", "expected"), [((37, 153), (37, 153)), ((153, 153), (0, 0))])
def test_the_progress_is_that_of_all_processes(
    monkeypatch: pytest.MonkeyPatch, count: tuple[int, int], expected: tuple[int, int]
) -> None:
    monkeypatch.setattr(warmth, "count_compiled", lambda: Compiled(*count))
    assert tuple(warmth.progress().values()) == expected


def test_the_process_that_workers_are_forked_from_does_not_compile(tmp_path: Path) -> None:
    code = "from equimesh_service.worker import warm_fork, warmth; raise SystemExit(7 + warmth._is_warm)"
    done = run(code, EQUIMESH_CACHE_DIR=str(tmp_path))
    assert (done.returncode, done.stderr) == (7, "")


def test_a_warm_up_that_breaks_is_reported_and_harms_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken() -> None:
        raise OSError("no memory")

    monkeypatch.setattr(warmth, "_has_basics", False)
    monkeypatch.setattr(warmth, "_is_warm", False)
    monkeypatch.setattr(warmth, "warm_up_basics", broken)
    warmth.warm_up_unless_compiling()
    assert not warmth._is_warm
    assert "the workers are not forked warm" in caplog.text


@pytest.mark.skipif(sys.platform != "linux", reason="the system counts threads otherwise")
def test_in_a_process_forked_from_a_warm_one_no_kind_of_problem_compiles_or_loads_a_loop() -> None:
    """Whether a loop is compiled or loaded depends on what ran before on this machine; neither may happen."""
    done = run(EVERY_KIND)
    assert done.returncode == 0, done.stderr
    count, *late = done.stdout.splitlines()
    assert late == []
    compiled, of = (int(number) for number in re.findall(r"\d+", count))
    assert compiled == of > 100


def test_a_worker_begins_with_the_loops_of_the_most_frequent_problems() -> None:
    done = run(BASIC_KINDS)
    assert done.returncode == 0, done.stderr
    count, *late = done.stdout.splitlines()
    assert late == []
    ready, of = map(int, count.split())
    assert ready < 0.7 * of


def test_a_worker_that_was_forked_warm_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(warmth, "warm_up_basics", lambda: calls.append(1))
    for has_basics, is_warm in ((False, True), (True, False), (False, False)):
        monkeypatch.setattr(warmth, "_has_basics", has_basics)
        monkeypatch.setattr(warmth, "_is_warm", is_warm)
        warmth.warm_up_for_basics()
    assert calls == [1]


# Says that it runs, then waits for the end of its input, as the process that compiles does.
WAITING = "import pathlib, sys; pathlib.Path(sys.argv[1]).touch(); sys.stdin.read()"
# Says its niceness in place of compiling, and does not end by itself.
ENDLESS = """
import os, time
from equimesh_service.worker import rare_loops, warmth
warmth.warm_up = lambda: (print(os.nice(0), flush=True), time.sleep(600))
rare_loops.compile_all()
"""


def incomplete() -> dict[str, int]:
    return {"compiled": 58, "of": 153}


def test_it_begins_when_the_workers_are_ready_and_ends_with_the_service(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ready: list[bool] = []
    looks: list[int] = []

    def is_ready() -> bool:
        looks.append(1)
        return bool(ready)

    loops = RareLoops(is_ready, incomplete, ("-c", WAITING, str(tmp_path / "runs")))
    with caplog.at_level(logging.INFO):
        loops.start()
        until(lambda: len(looks) > 2)
        assert not loops.are_compiling
        ready.append(True)
        until((tmp_path / "runs").exists)
        assert loops.are_compiling
        loops.stop()
    assert not loops.are_compiling
    assert caplog.messages == ["compiling loops of rare kinds: 58 of 153 are there"]


def test_where_all_loops_are_kept_no_process_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare_loops.subprocess, "Popen", lambda *_, **__: pytest.fail("starts a process"))
    loops = RareLoops(lambda: True, lambda: {"compiled": 0, "of": 0})
    loops._run()
    assert not loops.are_compiling


def test_a_process_that_fails_is_reported_and_harms_nothing(caplog: pytest.LogCaptureFixture) -> None:
    loops = RareLoops(lambda: True, incomplete, ("-c", "raise SystemExit(3)"))
    loops._run()
    assert not loops.are_compiling
    assert "loops of rare kinds are compiled when they are needed: exit status 3" in caplog.messages


def test_workers_count_the_loops_and_nobody_waits_for_one_that_is_late() -> None:
    asked: list[Future[Mapping[str, int]]] = []

    def ask() -> Future[Mapping[str, int]]:
        asked.append(Future())
        return asked[-1]

    count = LoopCount(ask)
    assert count.latest() == count.latest() == {"compiled": 0, "of": 0}
    assert len(asked) == 1
    asked[0].set_result(incomplete())
    assert count.latest() == incomplete()
    asked[1].set_exception(EngineError("it stops"))
    assert count.latest() == incomplete()
    asked[2].cancel()
    assert count.latest() == incomplete(), "the last one that is known"
    failed: Future[Mapping[str, int]] = Future()
    failed.set_exception(EngineError("it stops"))
    assert LoopCount(lambda: failed).now()["of"] == 0


@pytest.mark.skipif(not hasattr(os, "nice"), reason="the system has no niceness")
def test_the_process_is_of_low_priority_and_ends_when_its_input_is_closed() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDLESS], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert int(process.stdout.readline()) == min(os.nice(0) + rare_loops.NICENESS, 19)
        process.stdin.close()
        assert process.wait(60.0) == 1


@pytest.fixture
def storage(tmp_path: Path, database_url: str) -> Storage:
    """A storage that a service has prepared."""
    found = Storage(database_url, FilesAddress(folder=tmp_path / "files"))
    store = found.store()
    store.prepare()
    store.close()
    found.files().prepare(alone=True)
    return found


def test_the_same_storage_is_recognised(storage: Storage) -> None:
    assert not Reach.of(storage, mark=False).is_marked
    reach = Reach.of(storage)
    assert reach == Reach.of(storage)
    assert reach.is_marked
    assert reach.describe_faults() == ""


def test_another_folder_of_the_same_name_is_not(storage: Storage) -> None:
    reach = Reach.of(storage)
    (storage.address.folder / module.MARK).write_text("another")
    assert reach.describe_faults() == f"it does not see the folder of the service's files, {storage.address.folder}"


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_sqlite_needs_the_machine_and_the_file_of_the_service(storage: Storage) -> None:
    reach = Reach.of(storage)
    elsewhere = replace(reach, machine="another")
    assert "SQLite needs one machine, PostgreSQL does not" in elsewhere.describe_faults()
    other = replace(reach, file=(reach.file[0], reach.file[1] + 1))
    assert "it does not see the database of the service" in other.describe_faults()


def test_a_database_that_does_not_answer_or_is_another_is_told_without_its_address(storage: Storage) -> None:
    down = "postgresql+psycopg://user:secret@127.0.0.1:1/none"
    reach = replace(Reach.of(storage), storage=replace(storage, database_url=down))
    assert reach.describe_faults() == "it cannot reach the database of the service (OperationalError)"


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_a_database_without_the_tables_is_another(tmp_path: Path, database_url: str) -> None:
    storage = Storage(database_url, FilesAddress(folder=tmp_path / "files"))
    storage.files().prepare(alone=True)
    assert Reach.of(storage).describe_faults() == "it reaches another database than the service, without its tables"


def test_files_that_cannot_be_written_are_told(storage: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    from equimesh_service.files.folder import FolderFiles

    def full(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    reach = Reach.of(storage)
    monkeypatch.setattr(FolderFiles, "prepare", full)
    assert reach.describe_faults() == "it cannot use the files of the service: Permission denied"
