"""Too little memory is said before the start."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, Status, Worker

import equimesh as em
from equimesh_cluster import ClusterError
from equimesh_cluster import workers as module
from equimesh_cluster.workers import (
    BYTES_A_POINT,
    PACKAGES,
    WorkerFacts,
    check_memory,
    check_versions,
    equal_rows,
    examine_scheduler,
    examine_workers,
    memory_of_samples,
    rows_of_parts,
    versions,
)

GRID = em.Grid(n_xi=4098, n_eta=1024)
PROBLEM = em.Problem(monitor=em.ArcLength(u=em.Expression("x*y")), grid=GRID)
NEEDED = BYTES_A_POINT * 1026 * 1024  # of each of four parts


def worker(address: str, host: str, *, limit: int = 0, used: int = 0, free: int = 10 * NEEDED) -> WorkerFacts:
    return WorkerFacts(
        address=address, identity="", host=host, threads=2, versions={}, limit=limit, used=used, free=free
    )


def test_rows_are_those_that_the_parts_hold() -> None:
    assert rows_of_parts(GRID, 4) == [1026] * 4
    assert rows_of_parts(GRID, 1) == [4098]
    assert max(rows_of_parts(em.Grid(n_xi=1154, n_eta=256), 8)) == 258
    assert equal_rows(em.Grid(n_xi=1154, n_eta=256), 8) == [147] * 8


def test_the_part_with_most_rows_needs_most_memory() -> None:
    grid = em.Grid(n_xi=1154, n_eta=256)
    problem = em.Problem(monitor=PROBLEM.monitor, grid=grid)
    needs = [BYTES_A_POINT * 256 * rows for rows in rows_of_parts(grid, 8)]
    enough = [worker(str(k), str(k), free=need) for k, need in enumerate(needs)]
    check_memory(problem, enough)
    most = needs.index(max(needs))
    enough[most] = worker("most", "most", free=max(needs) - 1)
    with pytest.raises(ClusterError, match="the machine most"):
        check_memory(problem, enough)
    check_memory(problem, enough, rows=equal_rows(em.Grid(n_xi=577, n_eta=256), 8))


def test_workers_with_enough_memory_are_taken() -> None:
    check_memory(PROBLEM, [worker(name, name) for name in "abcd"])
    limit = int((NEEDED + 1000) / 0.95) + 1
    check_memory(PROBLEM, [worker(name, name, limit=limit, used=1000) for name in "abcd"])


@pytest.mark.parametrize("used", [0, 10_000_000])
def test_a_limit_that_is_too_low_is_named_with_both_numbers(used: int) -> None:
    low = worker("tcp://low:1", "c", limit=NEEDED, used=used)
    left = f"{(0.95 * NEEDED - used) / 1e9:.3g} GB left of its memory limit"
    text = f"the worker tcp://low:1 has {left}, and a part of 4098 x 1024 points take {NEEDED / 1e9:.3g} GB"
    with pytest.raises(ClusterError, match=re.escape(text)):
        check_memory(PROBLEM, [worker("a", "a"), worker("b", "b"), low, worker("d", "d")])


def test_parts_of_one_worker_and_workers_of_one_machine_are_added() -> None:
    one = worker("a", "a", limit=2 * NEEDED)
    with pytest.raises(ClusterError, match="and 2 parts of"):
        check_memory(PROBLEM, [one, one, worker("c", "c"), worker("d", "d")])
    small = [worker(name, "host", free=3 * NEEDED) for name in "abcd"]
    check_memory(PROBLEM, [*small[:3], worker("d", "other")])
    with pytest.raises(ClusterError, match=r"the machine host has .* free, and 4 parts of"):
        check_memory(PROBLEM, small)


def test_splines_of_samples_in_a_file_are_counted(tmp_path: Path) -> None:
    x, y = np.linspace(0, 1, 400), np.linspace(0, 1, 300)
    np.savez(tmp_path / "u.npz", x=x, y=y, values=np.ones((400, 300)) * x[:, None])
    for max_bytes, each in ((1 << 30, 8 * 400 * 300 // 4), (100_000, 100_000)):
        u = em.ChunkedSamples(path=tmp_path / "u.npz", max_bytes=max_bytes)
        problem = em.Problem(monitor=em.ArcLength(u=u), grid=GRID)
        assert memory_of_samples(problem, 4) == each
        just_enough = [worker(name, name, free=NEEDED + each) for name in "abcd"]
        check_memory(problem, just_enough)
        too_little = [*just_enough[:3], worker("d", "d", free=NEEDED + each - 1)]
        with pytest.raises(ClusterError, match="the machine d"):
            check_memory(problem, too_little)
        check_memory(PROBLEM, too_little)
    assert memory_of_samples(PROBLEM, 4) == 0


# What workers say about themselves.


def test_workers_say_who_they_are_and_what_they_have(client: Client) -> None:
    facts = examine_workers(client)
    assert [one.address for one in facts] == sorted(client.nthreads())
    assert len({one.identity for one in facts}) == 3
    assert {one.threads for one in facts} == {2}
    assert all(one.versions == versions() and set(one.versions) == set(PACKAGES) for one in facts)
    assert all(one.used > 0 and one.free > 0 and one.limit == 0 for one in facts)
    (one,) = examine_workers(client, [facts[1].address])
    assert one == replace(facts[1], used=one.used, free=one.free)


def test_a_worker_that_is_gone_is_left_out(client: Client) -> None:
    assert examine_workers(client, ["tcp://127.0.0.1:9"]) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_another_version_is_refused_by_name(client: Client, package: str) -> None:
    facts = examine_workers(client)
    found = {facts[0].address: facts[0].versions, facts[1].address: {**facts[1].versions, package: "0.0.1"}}
    pattern = f"versions differ: {facts[1].address} has {package} 0.0.1, and {versions()[package]} is here. Install"
    with pytest.raises(ClusterError, match=pattern):
        check_versions(found)


def test_a_scheduler_of_another_version_is_refused(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    examine_scheduler(client)

    def older() -> dict[str, str]:
        return {**here, "equimesh": "0.0.1"}

    here = versions()
    with monkeypatch.context() as patch:
        patch.setattr(client, "run_on_scheduler", lambda _: older())
        with pytest.raises(ClusterError, match=r"the scheduler has equimesh 0\.0\.1, and"):
            examine_scheduler(client)


def test_a_worker_without_equimesh_is_refused_by_name(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ModuleNotFoundError("No module named 'equimesh'")

    monkeypatch.setattr(module, "examine", missing)
    with pytest.raises(ClusterError, match=r"has no equimesh .*No module named.*: install equimesh\[dask\]==") as error:
        examine_workers(client)
    assert any(address in str(error.value) for address in client.nthreads())


def test_a_worker_that_takes_no_tasks_is_refused_by_name_and_one_that_ends_is_left_out(client: Client) -> None:
    def become(status: Status, dask_worker: Worker) -> None:
        dask_worker.status = status

    first, *others = sorted(client.nthreads())
    try:
        client.run(become, Status.paused, workers=[first])
        with pytest.raises(ClusterError, match=f"paused, so that they take no tasks: {first}. Dask pauses"):
            examine_workers(client)
        assert [one.address for one in examine_workers(client, others)] == others
        client.run(become, Status.closing_gracefully, workers=[first])
        assert [one.address for one in examine_workers(client)] == others
    finally:
        client.run(become, Status.running, workers=[first])
    assert [one.status for one in examine_workers(client)] == ["running"] * 3
