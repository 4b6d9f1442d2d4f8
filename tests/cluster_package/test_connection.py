"""The connection to a scheduler: which worker runs which part, with how much memory, and what is imported."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, Future, LocalCluster, Status, Worker

import equimesh as em
from equimesh import InputError
from equimesh_cluster import ClusterError, NoSchedulerError, RunCancelledError, WorkersLostError, connect, connection
from equimesh_cluster import workers as module
from equimesh_cluster.connection import MAX_INLINE_BYTES, check_client, leases_of, sent
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
    place,
    rows_of_parts,
    versions,
)


def test_an_address_without_a_scheduler_is_named_with_what_to_start() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ClusterError, match=f"no scheduler answers at {address} .*start one with `dask scheduler`"):
            connect(address, timeout=0.2)


@pytest.mark.parametrize("faults", [2, 3])
def test_a_greeting_that_comes_with_another_message_is_repeated(monkeypatch: pytest.MonkeyPatch, faults: int) -> None:
    made = list[str]()

    def client(address: str, **_: object) -> str:
        made.append(address)
        assert len(made) > faults
        return "client"

    monkeypatch.setattr(connection, "Client", client)
    if faults == 2:
        assert connect("tcp://here:1") == "client"
    else:
        with pytest.raises(ClusterError, match="no scheduler answers"):
            connect("tcp://here:1")
    assert len(made) == 3


def test_what_is_no_address_is_refused() -> None:
    with pytest.raises(InputError, match="client = 'ftp://nowhere:1' is no address") as error:
        connect("ftp://nowhere:1", timeout=0.2)
    assert error.value.field == "client"


def test_a_connected_client_is_taken_and_others_are_refused(client: Client) -> None:
    assert check_client(client) is client
    with pytest.raises(InputError, match="client = '8786' is no client"):
        check_client(8786)
    with connect(client.scheduler.address) as other:
        check_client(other)
    with pytest.raises(ClusterError, match=r"is not connected \(status closed\)"):
        check_client(other)


# What is sent to workers.


def test_small_values_are_sent_with_their_task_and_large_ones_are_data_of_the_cluster(client: Client) -> None:
    small = {"n": 3}
    assert sent(client, small) is small
    large = np.arange(MAX_INLINE_BYTES // 8 + 1.0)
    found = sent(client, large)
    assert isinstance(found, Future)
    assert client.submit(lambda values: values.sum(), found, pure=False).result() == large.sum()


# One run at a time on a worker.


def nothing() -> None:
    """Nobody has cancelled."""


def refuse() -> None:
    raise RunCancelledError("enough")


def test_a_worker_is_leased_once_at_a_time(client: Client) -> None:
    a, b, c = client.nthreads()
    with leases_of(client, [a, b, a], nothing):
        with leases_of(client, [c], nothing):
            pass
        with pytest.raises(RunCancelledError), leases_of(client, [c, b], refuse):
            pass
        with leases_of(client, [c], refuse):  # what was taken before the refusal is free again
            pass
    with leases_of(client, [a, b, c], refuse):
        pass


def test_who_waits_for_a_lease_gets_it_when_it_is_free(client: Client) -> None:
    a, order = next(iter(client.nthreads())), []

    def wait() -> None:
        with leases_of(client, [a], nothing):
            order.append("second")

    waiting = threading.Thread(target=wait)
    with leases_of(client, [a], nothing):
        waiting.start()
        order.append("first")
    waiting.join(timeout=60)
    assert order == ["first", "second"]


def test_the_lease_of_a_client_that_is_gone_expires(client: Client) -> None:
    a = next(iter(client.nthreads()))
    gone = Client(client.scheduler.address, set_as_default=False)
    held = leases_of(gone, [a], nothing)
    held.__enter__()
    with pytest.raises(RunCancelledError), leases_of(client, [a], refuse):
        pass
    gone.close()
    with leases_of(client, [a], nothing):
        pass


def test_a_worker_that_is_lost_is_not_waited_for(client: Client) -> None:
    with (
        leases_of(client, ["tcp://127.0.0.1:9"], nothing),
        pytest.raises(WorkersLostError, match=r"127\.0\.0\.1:9 was lost"),
        leases_of(client, ["tcp://127.0.0.1:9"], nothing),
    ):
        pass


def test_a_scheduler_that_is_lost_meanwhile_is_said() -> None:
    options = {"dashboard_address": ":0", "processes": False, "threads_per_worker": 1, "memory_limit": 0}
    with (
        LocalCluster(n_workers=1, **options) as cluster,
        Client(cluster, set_as_default=False, timeout=10) as one,
        Client(cluster, set_as_default=False, timeout=10) as other,
    ):
        (a,) = one.nthreads()
        with (
            leases_of(other, [a], nothing),
            pytest.raises(NoSchedulerError, match="is not connected"),
            leases_of(one, [a], cluster.close),
        ):
            pass


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


def worker_of(address: str, threads: int = 1) -> WorkerFacts:
    return WorkerFacts(
        address=address, identity=address, host="h", threads=threads, versions={}, limit=0, used=0, free=0
    )


def test_a_worker_has_neighbours_and_not_more_parts_than_threads() -> None:
    workers = [worker_of("a", 2), worker_of("b", 1), worker_of("c", 4)]
    assert [one.address for one in place(3, workers)] == ["a", "b", "c"]
    assert [one.address for one in place(5, workers)] == ["a", "a", "b", "c", "c"]
    assert [one.address for one in place(7, workers)] == ["a", "a", "b", "c", "c", "c", "c"]
    assert [one.address for one in place(2, workers)] == ["a", "b"]


@pytest.mark.parametrize("count", [0, 4, -1])
def test_more_parts_than_threads_are_refused_with_the_largest_number(count: int) -> None:
    with pytest.raises(InputError, match=f"parts = {count}: .* 2 workers have 3 threads .* take 1 to 3 parts") as error:
        place(count, [worker_of("a", 2), worker_of("b")])
    assert error.value.field == "parts"


@pytest.mark.parametrize("count", [2.5, "3", True])
def test_parts_that_are_no_whole_number_are_refused(count: object) -> None:
    with pytest.raises(InputError, match=f"parts = {count!r}: a whole number") as error:
        place(count, [worker_of("a", 2), worker_of("b")])  # type: ignore[arg-type]
    assert error.value.field == "parts"


WITHOUT_DASK = """
import sys
sys.modules["distributed"] = None
import equimesh_cluster
assert equimesh_cluster.read_parts and "dask" not in sys.modules
try:
    equimesh_cluster.solve
except ImportError as error:
    print(error)
"""


def test_files_need_no_dask_and_the_other_names_say_how_to_install_it() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_DASK], capture_output=True, text=True, timeout=120)
    assert done.stdout == "this needs distributed, which is not installed: pip install 'equimesh[dask]'\n", done.stderr
