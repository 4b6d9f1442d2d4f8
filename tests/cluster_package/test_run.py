"""One function on many workers at the same time."""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import Any

import numpy as np
import pytest
from distributed import Client

from dask_processes import DaskProcesses
from equimesh import InputError
from equimesh_cluster import PartsRun, RunOptions, WorkersLostError, run_parts
from equimesh_cluster.channel import PLUGIN
from equimesh_cluster.messages import PeerLostError
from equimesh_cluster.run import Attempt, AttemptFailure
from equimesh_cluster.workers import WorkerFacts, examine_workers


def around(channel: Any, rounds: int) -> float:
    """A number that goes around all parts, each of which adds 1."""
    total = np.array([float(channel.number)])
    for _ in range(rounds):
        channel.send((channel.number + 1) % channel.count, "total", [total])
        total[0] = -1.0  # a message is a copy
        total = channel.receive((channel.number - 1) % channel.count, "total")[0] + 1.0
    return float(total[0])


def results(run: PartsRun) -> list[Any]:
    return [future.result() for future in run.futures]


def left_on(client: Client) -> dict[str, tuple[list[Any], list[Any], list[Any]]]:
    """Boxes, results and tasks on each worker that has the plugin."""

    def left(dask_worker: Any) -> tuple[list[Any], list[Any], list[Any]]:
        boxes = dask_worker.plugins[PLUGIN].boxes if PLUGIN in dask_worker.plugins else ()
        data, tasks = (
            [key for key in keys if "equimesh" in key] for keys in (dask_worker.data, dask_worker.state.tasks)
        )
        return [*boxes], data, tasks

    return client.run(left)


def require_nothing_left(client: Client) -> None:
    """Wait until nothing is left on the workers."""
    latest = time.monotonic() + 30.0
    while any(found != ([], [], []) for found in left_on(client).values()):
        assert time.monotonic() < latest, left_on(client)
        time.sleep(0.02)


@pytest.mark.parametrize("parts", [1, 3, 5])
def test_parts_run_at_the_same_time_and_talk_to_each_other(client: Client, parts: int) -> None:
    run = run_parts(client, around, lambda _, count: (2 * count,), parts=parts)
    assert results(run) == [number + 2.0 * parts for number in range(parts)]
    assert len(set(run.workers)) == min(parts, 3)
    assert (run.attempts, run.lost) == (1, ())
    where = client.who_has(list(run.futures))
    assert [where[future.key][0] for future in run.futures] == list(run.workers)
    del run
    require_nothing_left(client)


def test_the_default_is_one_part_for_each_worker(client: Client) -> None:
    assert len(run_parts(client, around, lambda _, __: (1,)).futures) == 3
    one = sorted(client.nthreads())[1]
    assert run_parts(client, around, lambda _, __: (1,), workers=[one]).workers == (one,)


def test_reports_reach_the_caller_in_its_own_thread(client: Client) -> None:
    def reporting(channel: Any) -> None:
        for step in range(3):
            channel.report((step, np.float64(channel.number)))

    seen, threads = [], set()

    def observe(number: int, value: Any) -> None:
        seen.append((number, *value))
        threads.add(threading.get_ident())

    run_parts(client, reporting, lambda _, __: (), parts=2, options=RunOptions(observe=observe))
    assert sorted(seen) == [(number, step, float(number)) for number in range(2) for step in range(3)]
    assert [step for number, step, _ in seen if number == 1] == [0, 1, 2]
    assert threads == {threading.get_ident()}


def test_the_error_of_a_part_is_the_callers_and_the_others_do_not_wait(client: Client) -> None:
    def failing(channel: Any) -> None:
        if channel.number == 1:
            raise ArithmeticError("the matrix is singular")
        channel.receive(1, "never")

    with pytest.raises(ArithmeticError, match="the matrix is singular"):
        run_parts(client, failing, lambda _, __: (), parts=5)
    require_nothing_left(client)


def test_an_error_of_the_observer_ends_the_run(client: Client) -> None:
    def waiting(channel: Any) -> None:
        channel.report(0)
        channel.receive((channel.number + 1) % 2, "never")

    def observe(*_: Any) -> None:
        raise KeyError("the caller's own")

    with pytest.raises(KeyError, match="the caller's own"):
        run_parts(client, waiting, lambda _, __: (), parts=2, options=RunOptions(observe=observe))
    require_nothing_left(client)


def test_too_many_parts_are_refused_and_workers_looked_at_before_the_start(client: Client) -> None:
    with pytest.raises(InputError, match="take 1 to 6 parts"):
        run_parts(client, around, lambda _, __: (1,), parts=7)
    places: list[WorkerFacts] = []

    def refuse(found: list[WorkerFacts]) -> None:
        places.extend(found)
        raise InputError("not enough memory")

    with pytest.raises(InputError, match="not enough memory"):
        run_parts(client, around, lambda _, __: (1,), parts=4, options=RunOptions(check_workers=refuse))
    assert len(places) == 4


def test_two_runs_at_the_same_time_do_not_block_each_other(client: Client) -> None:
    found: dict[int, list[Any]] = {}

    def one(number: int) -> None:
        found[number] = results(run_parts(client, around, lambda _, __: (50,), parts=5))

    threads = [threading.Thread(target=one, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
    assert found == {key: [50.0 + number for number in range(5)] for key in range(3)}


def test_a_lost_worker_begins_the_run_again_on_those_left(processes: DaskProcesses) -> None:
    processes.have(2)

    def kill(number: int, pid: int) -> None:
        if len(killed) == 0 and number == 1:
            address = run_on[pid]
            killed.append(address)
            processes.kill(processes.name_at(address))

    def reporting(channel: Any) -> float:
        channel.report(os.getpid())
        if channel.count == 2:
            channel.receive(1 - channel.number, "never")  # until the other one is killed
        return float(channel.count)

    killed: list[str] = []
    run_on = {pid: address for address, pid in processes.client.run(os.getpid).items()}
    run = run_parts(processes.client, reporting, lambda _, __: (), options=RunOptions(observe=kill))
    assert results(run) == [1.0]
    assert (run.attempts, run.lost) == (2, tuple(killed))
    del run
    require_nothing_left(processes.client)


def test_workers_that_are_lost_again_and_again_end_the_run(processes: DaskProcesses) -> None:
    processes.have(2)

    def suicidal(_: Any) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(WorkersLostError, match=r"no worker is left; lost: tcp://.*\. Start workers") as error:
        run_parts(processes.client, suicidal, lambda _, __: ())
    assert len(error.value.lost) in (1, 2)  # on a busy machine one is gone before it has begun
    processes.have(1)
    options = RunOptions(attempts=1)
    with pytest.raises(WorkersLostError, match=r"given up after 1 attempts .*run out of memory"):
        run_parts(processes.client, suicidal, lambda _, __: (), parts=1, options=options)


# One attempt of a run.


def nothing(*_: Any) -> None:
    """Nobody looks, nobody cancels."""


@pytest.fixture
def places(client: Client) -> list[WorkerFacts]:
    return examine_workers(client)


def test_a_part_that_lost_a_peer_is_no_error_of_its_own(client: Client, places: list[WorkerFacts]) -> None:
    def cut_off(channel: Any) -> None:
        if channel.number == 2:
            raise PeerLostError("part 0 cannot be reached")
        channel.receive(2, "never")

    lost = Attempt(client, places, nothing).results(cut_off, lambda *_: (), nothing)
    assert isinstance(lost, AttemptFailure)
    assert lost.workers == ()
    assert "part 2 on" in lost.reason
    assert "part 0 cannot be reached" in lost.reason


def test_arguments_may_be_futures(client: Client, places: list[WorkerFacts]) -> None:
    shared = client.submit(lambda: 40, pure=False)
    attempt = Attempt(client, places, nothing)
    futures = attempt.results(lambda channel, one: channel.count + one, lambda *_: (shared,), nothing)
    assert not isinstance(futures, AttemptFailure)
    assert [future.result() for future in futures] == [43, 43, 43]


def test_a_worker_that_is_not_there_is_lost(client: Client, places: list[WorkerFacts]) -> None:
    gone = WorkerFacts(
        address="tcp://127.0.0.1:9", identity="", host="h", threads=1, versions={}, limit=0, used=0, free=0
    )

    def waiting(channel: Any) -> None:
        channel.receive(1, "never")

    lost = Attempt(client, [places[0], gone], nothing).results(waiting, lambda *_: (), nothing)
    assert lost == AttemptFailure(("tcp://127.0.0.1:9",), "lost: tcp://127.0.0.1:9")
    left = client.run(lambda dask_worker: len(dask_worker.plugins["equimesh-messages"].boxes))
    assert set(left.values()) == {0}
