"""One mesh on the workers of a cluster: equal to the whole one to the last bit, and none of it left behind."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client

import equimesh as em
from dask_processes import DaskProcesses
from equimesh.errors import InputError
from equimesh.meshes import rows
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.types import Array
from equimesh.testing.geometries import l_shape, obstacle
from equimesh_cluster import (
    PARTED_FORMATS,
    ClusterError,
    Progress,
    RunCancelledError,
    connect,
    read_parts,
    run_parts,
    solve,
    solve_blocks,
    solving,
)
from equimesh_cluster.channel import PLUGIN
from equimesh_cluster.mesh_part import MeshPart, cut
from equimesh_cluster.parts.solve import coarse_solution
from meshes_on_workers import PROBLEM, handle_on

RING = em.ArcLength(u=em.Expression("tanh(12*(hypot(x, y) - 0.7))"))
SMALL = em.Problem(monitor=RING, grid=em.Grid(n_xi=257, n_eta=129))
LARGE = em.Problem(monitor=RING, grid=em.Grid(n_xi=1025, n_eta=513))
"""The smallest nested grid whose last level is solved in parts."""
EQUAL = 0.0
WAITS = """
import sys
from distributed import Client
from equimesh_cluster import RunOptions, run_parts

def waits(channel):
    channel.report(channel.number)
    channel.receive(1 - channel.number, "never")

if __name__ == "__main__":
    told = RunOptions(observe=lambda number, _: print("runs", number, flush=True))
    run_parts(Client(sys.argv[1]), waits, lambda *_: (), parts=2, options=told)
"""


TWO_PEAKS = "exp(-80*((x-0.3)**2 + (y-0.3)**2)) + exp(-80*((x-0.7)**2 + (y-0.7)**2))"
RELAXED = em.Problem(monitor=em.ArcLength(u=em.Expression(TWO_PEAKS)), grid=em.Grid(n_xi=33, n_eta=33))


@pytest.fixture
def small_levels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Small grids are solved in parts, too: the coarse one has at most 65 x 65 points, and strips have 16 rows."""
    caches = rows.strips_of, rows._whole
    for cache in caches:
        cache.cache_clear()
    monkeypatch.setattr(rows, "STRIP_NODES", 1024)
    monkeypatch.setattr(solving, "coarse_solution", partial(coarse_solution, max_points=65 * 65))
    yield
    for cache in caches:
        cache.cache_clear()


def largest_difference(found: Array, whole: Array) -> float:
    """The largest distance between two arrays of one shape."""
    assert found.shape == whole.shape
    return float(np.abs(found - whole).max())


def left_on(client: Client) -> dict[str, tuple[int, list[Any]]]:
    """Boxes and data of solves on each worker."""

    def left(dask_worker: Any) -> tuple[int, list[Any]]:
        boxes = dask_worker.plugins[PLUGIN].boxes if PLUGIN in dask_worker.plugins else ()
        return len(boxes), [*dask_worker.data]

    return client.run(left)


def require_nothing_left(client: Client) -> None:
    latest = time.monotonic() + 60.0
    while any(found != (0, []) for found in left_on(client).values()):
        assert time.monotonic() < latest, left_on(client)
        time.sleep(0.02)


@pytest.mark.usefixtures("small_levels")
@pytest.mark.parametrize(("parts", "mode"), [(1, em.Mode.TIGHT), (3, em.Mode.DISCRETIZATION), (5, em.Mode.TIGHT)])
def test_the_mesh_is_equal_to_the_whole_one(client: Client, parts: int, mode: em.Mode) -> None:
    whole = em.solve(SMALL, mode=mode)
    with solve(SMALL, client, parts=parts, mode=mode) as handle:
        assert (handle.status, handle.count) == (whole.status, parts)
        assert handle.discretization_error == pytest.approx(whole.discretization_error, rel=1e-9)
        assert largest_difference(client.compute(handle.x).result(), whole.mesh.x) <= EQUAL
        assert largest_difference(client.compute(handle.y).result(), whole.mesh.y) <= EQUAL
        assert handle.newton_steps == whole.newton_steps
    del handle
    require_nothing_left(client)


@pytest.mark.usefixtures("small_levels")
def test_the_observer_sees_every_level_and_all_that_was_sent(client: Client) -> None:
    seen: list[Progress] = []
    with solve(SMALL, client, parts=4, observe=seen.append) as handle:
        sent = sum(traffic.bytes for traffic in handle.traffic.values())
        assert sum(step.bytes for step in seen) == sent > 0
        assert sum(step.messages for step in seen) == sum(one.messages for one in handle.traffic.values())
    assert {step.level for step in seen} == set(range(seen[-1].levels))
    assert seen[-1].grid == SMALL.grid
    assert [step.parts for step in seen] == sorted(step.parts for step in seen)
    assert {step.parts for step in seen} == {1, 4}


@pytest.mark.usefixtures("small_levels")
def test_a_solve_is_cancelled_and_leaves_nothing(client: Client) -> None:
    cancel = threading.Event()

    def observe(step: Progress) -> None:
        if step.parts > 1:
            cancel.set()

    with pytest.raises(RunCancelledError):
        solve(SMALL, client, parts=3, mode=em.Mode.TIGHT, observe=observe, cancel=cancel)
    require_nothing_left(client)


def test_arguments_that_cannot_be_used_are_refused(client: Client) -> None:
    with pytest.raises(em.InputError, match="problem = 'u' is no problem"):
        solve("u", client)  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="client = '7' is no client"):
        solve(PROBLEM, 7)  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="mode"):
        solve(PROBLEM, client, mode="loose")  # type: ignore[arg-type]
    with pytest.raises(em.InputError, match="least_error has no metric, and is not solved in parts"):
        solve(em.Problem(monitor=em.LeastError(u=RING.u), grid=SMALL.grid), client)
    with pytest.raises(em.InputError, match="subdomains of a grid descend on the error on one machine"):
        solve(em.Problem(monitor=em.LeastError(u=RING.u), grid=SMALL.grid), client, schwarz=em.Schwarz())
    with pytest.raises(em.InputError, match="parts = 7: all parts run at the same time"):
        solve(LARGE, client, parts=7)
    with pytest.raises(em.InputError, match="the grids of this solve cannot be cut into more"):
        solve(em.Problem(monitor=RING, grid=em.Grid(n_xi=33, n_eta=33)), client, parts=4)


def test_too_little_memory_is_said_before_anything_is_computed(client: Client) -> None:
    vast = em.Problem(monitor=RING, grid=em.Grid(n_xi=524289, n_eta=524289))
    with pytest.raises(ClusterError, match=r"the machine .* has .* GB free, and 3 parts of 524289 x 524289 points"):
        solve(vast, client)


def test_a_failure_of_the_coarse_solve_is_the_callers(client: Client) -> None:
    with pytest.raises(em.SolveError, match="No valid mesh was found that satisfies the requested") as error:
        solve(RELAXED, client, allow_relaxed=False)
    assert error.value.solution.status is em.Status.NEWTON_FAILED
    del error
    require_nothing_left(client)


@pytest.mark.everything  # a run begins again on those left in tests/cluster_package/test_run.py, with fewer points
@pytest.mark.parametrize("stage", ["sweeps", "coarse"])
def test_a_worker_that_is_killed_changes_nothing_in_the_mesh(processes: DaskProcesses, stage: str) -> None:
    processes.have(2)
    killed: list[str] = []

    def observe(step: Progress) -> None:
        if stage == ("coarse" if step.parts == 1 else "sweeps") and not killed:
            killed.append(min(processes.client.nthreads()))  # the worker of the coarse solution, and of part 0
            processes.kill(processes.name_at(killed[0]))

    with solve(LARGE, processes.client, observe=observe) as handle:
        assert killed
        assert killed[0] not in handle.workers
        assert handle.attempts == (2 if stage == "sweeps" else 1)
        x = processes.client.compute(handle.x).result()
    assert largest_difference(x, em.solve(LARGE).mesh.x) <= EQUAL
    del handle
    require_nothing_left(processes.client)


def test_a_driver_that_is_killed_leaves_nothing_and_its_workers_are_free_again(
    processes: DaskProcesses, tmp_path: Path
) -> None:
    processes.have(2)
    program = tmp_path / "waits.py"
    program.write_text(WAITS)
    settings = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__LOCKS__LEASE_TIMEOUT": "2s"}
    command = [sys.executable, str(program), processes.address]
    with subprocess.Popen(command, env=settings, stdout=subprocess.PIPE, text=True) as driver:
        assert {driver.stdout.readline(), driver.stdout.readline()} == {"runs 0\n", "runs 1\n"}
        assert sum(boxes for boxes, _ in left_on(processes.client).values()) == 2
        driver.kill()
    require_nothing_left(processes.client)
    with connect(processes.address) as client:
        assert len(run_parts(client, lambda channel: channel.number, lambda *_: (), parts=2).futures) == 2


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("threads", {"threads": 0}),
        ("threads", {"threads": "x"}),
        ("threads", {"threads": None}),
        ("observe", {"observe": 7}),
        ("monitor", {"problem": em.Problem(monitor=em.Auto(u=em.Expression("x*y")), grid=SMALL.grid)}),
        ("monitor", {"problem": em.Problem(monitor=em.LeastError(u=em.Expression("x*y")), grid=SMALL.grid)}),
    ],
)
def test_bad_arguments_are_refused_before_a_scheduler_is_asked(field: str, change: dict[str, Any]) -> None:
    with pytest.raises(em.InputError) as error:
        solve(**{"problem": SMALL, "client": "tcp://127.0.0.1:9", **change})
    assert error.value.field == field


# Files of a mesh on a cluster.


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_every_worker_writes_its_part_and_the_caller_the_head(client: Client, tmp_path: Path, name: str) -> None:
    solution = em.solve(PROBLEM)
    head = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}"
    with handle_on(client, solution, 10, 20) as handle:
        assert handle.write(head) == head
    found = read_parts(head)
    assert found.nodes == ("u",)
    assert sorted(found.cells) == ["Q_eq", "subdomain"]
    assert found.cuts == (10, 20)
    for array, whole in (("x", solution.mesh.x), ("y", solution.mesh.y), ("u", solution.u)):
        assert np.array_equal(found.rows(array, 0, 33), whole)
    assert found.rows("Q_eq", 0, 32) == pytest.approx(solution.data().q_eq, rel=1e-12, abs=0)
    assert not list(tmp_path.glob(".equimesh-*"))


def test_q_eq_is_left_out_on_request(client: Client, tmp_path: Path) -> None:
    with handle_on(client, em.solve(PROBLEM), 16) as handle:
        handle.write(tmp_path / "mesh.pvtu", q_eq=False)
    assert tuple(read_parts(tmp_path / "mesh.pvtu").cells) == ("subdomain",)


def test_a_folder_that_is_not_there_is_refused(client: Client, tmp_path: Path) -> None:
    with (
        handle_on(client, em.solve(PROBLEM), 16) as handle,
        pytest.raises(em.InputError, match=r"there is no folder .*nowhere on this machine"),
    ):
        handle.write(tmp_path / "nowhere" / "mesh.pvtu")
    with handle_on(client, em.solve(PROBLEM), 16) as handle, pytest.raises(em.InputError, match="pvtu"):
        handle.write(tmp_path / "mesh.doc")


FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
ON_BLOCKS = em.Problem(monitor=em.LeastError(u=FRONT), domain=obstacle(1200))


@pytest.mark.parametrize("parts", [2, None])
def test_the_mesh_does_not_depend_on_the_number_of_workers(client: Client, parts: int | None) -> None:
    alone, told = em.solve(ON_BLOCKS, em.Schwarz()), list[dict[str, Any]]()
    found = solve_blocks(ON_BLOCKS, client, parts=parts, observe=told.append)
    assert np.array_equal(found.mesh.points, alone.mesh.points)
    assert found.status is em.Status.COMPLETED
    assert found.interpolation == alone.interpolation
    assert len(told) == len(found.descent)
    assert told[-1]["error"] == found.descent[-1]["error"]


def test_what_does_not_fit_is_refused_before_the_start(client: Client) -> None:
    corner = em.Problem(monitor=em.LeastError(u=FRONT), domain=l_shape(300))
    with pytest.raises(em.InputError, match="parts = 4: every part needs a subdomain, so take at most 3"):
        solve_blocks(corner, client, parts=4)
    with pytest.raises(em.InputError, match="no block outlet"):
        solve_blocks(corner, client, em.Schwarz(groups=[["outlet"]]))
    with pytest.raises(em.InputError, match="no domain in blocks"):
        solve_blocks(em.Problem(monitor=em.LeastError(u=FRONT), grid=em.Grid(n_xi=9, n_eta=9)), client)  # type: ignore[arg-type]


def test_a_cancelled_solve_ends(client: Client) -> None:
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(RunCancelledError):
        solve_blocks(ON_BLOCKS, client, cancel=cancel)


MESH = Mesh.uniform(Grid(n_xi=9, n_eta=5))


def test_parts_together_are_the_mesh() -> None:
    parts = cut(MESH, [2, 3, 7])
    assert [part.number for part in parts] == [0, 1, 2, 3]
    assert all(part.count == 4 and part.grid == MESH.grid for part in parts)
    assert np.array_equal(np.concatenate([part.x[part.own_rows] for part in parts]), MESH.x)
    assert np.array_equal(np.concatenate([part.y[part.own_rows] for part in parts]), MESH.y)
    assert sum(part.last - part.first for part in parts) == MESH.grid.n_xi
    assert [part.is_last for part in parts] == [False, False, False, True]


def test_every_cell_belongs_to_one_part() -> None:
    parts = cut(MESH, [1, 6])
    assert np.array_equal(np.concatenate([part.first_node + part.cells for part in parts]), MESH.cells)
    assert [part.cell_rows for part in parts] == [(0, 1), (1, 6), (6, 8)]


def test_a_mesh_without_cuts_is_one_part() -> None:
    (part,) = cut(MESH, [])
    assert (part.first, part.last, part.is_last) == (0, 9, True)
    assert part.x.shape == (9, 5)


@pytest.mark.parametrize("cuts", [[0], [4, 4], [5, 3], [9], [12]])
def test_cuts_that_leave_a_part_without_rows_are_refused(cuts: list[int]) -> None:
    with pytest.raises(InputError, match="are not rows of a grid"):
        cut(MESH, cuts)


def test_a_part_without_the_first_row_of_the_next_one_is_refused() -> None:
    with pytest.raises(InputError, match=r"need the shape \(4, 5\)"):
        MeshPart(grid=MESH.grid, number=0, count=2, first=0, last=3, x=MESH.x[:3], y=MESH.y[:3])
