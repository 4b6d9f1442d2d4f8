"""The warm-up of processes: once, and not by compiling in the process that workers are forked from."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from equimesh.numerics.compiled import Compiled
from equimesh_service.worker import warmth

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
