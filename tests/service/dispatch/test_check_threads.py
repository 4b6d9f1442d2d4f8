"""Threads for checks: slow checks, which wait for a worker, do not delay the quick ones of others."""

from __future__ import annotations

import threading

import anyio
import pytest

from equimesh_service.dispatch.wakeups import CheckThreads
from equimesh_service.problems.problem import Problem


@pytest.mark.anyio
async def test_a_check_that_waits_for_a_worker_makes_room() -> None:
    check_threads, done, waits = CheckThreads(threads=1), threading.Event(), threading.Event()

    def slow() -> None:
        with check_threads.while_waiting(""):
            waits.set()
            done.wait(300.0)

    async with anyio.create_task_group() as group:
        group.start_soon(check_threads.run, slow)
        group.start_soon(check_threads.run, slow)
        with anyio.fail_after(60.0):
            while not await check_threads.run(waits.is_set):
                pass
        done.set()
    busy, begun = threading.Event(), threading.Event()

    def occupy() -> None:
        begun.set()
        busy.wait(300.0)

    async with anyio.create_task_group() as group:  # afterwards there is as much room as before
        group.start_soon(check_threads.run, occupy)
        with anyio.fail_after(60.0):
            while not begun.is_set():
                await anyio.sleep(0.01)
        with anyio.move_on_after(0.2) as scope:
            await check_threads.run(bool)
        assert scope.cancelled_caught
        busy.set()


class Slow:
    """Checks that wait for a worker until they end, and the problems of those that may not wait."""

    def __init__(self) -> None:
        self.check_threads, self.done = CheckThreads(threads=1), threading.Event()
        self.refused: list[Problem] = []

    def wait(self, key_id: str) -> None:
        try:
            with self.check_threads.while_waiting(key_id):
                self.done.wait(300.0)
        except Problem as problem:
            self.refused.append(problem)


@pytest.mark.anyio
async def test_one_key_does_not_take_all_the_room() -> None:
    slow = Slow()
    check_threads, done, refused, wait = slow.check_threads, slow.done, slow.refused, slow.wait

    def let_through() -> str:
        with check_threads.while_waiting("another"):
            return "seen"

    async with anyio.create_task_group() as group:
        for _ in range(40):
            group.start_soon(check_threads.run, wait, "k")
        with anyio.fail_after(60.0):
            while len(refused) < 8:
                await anyio.sleep(0.01)
            assert await check_threads.run(let_through) == "seen"
        done.set()
    assert {problem.name for problem in refused} == {"quota-exceeded"}
    assert refused[0].headers["Retry-After"] == "5"
    assert "This key has 32 uploads waiting to be read, the limit" in refused[0].detail
    await check_threads.run(wait, "k")  # done is set: there is room again
    assert len(refused) == 8


@pytest.mark.anyio
async def test_all_keys_together_leave_room_for_quick_checks() -> None:
    slow = Slow()
    check_threads, done, refused, wait = slow.check_threads, slow.done, slow.refused, slow.wait

    async with anyio.create_task_group() as group:
        for number in range(129):
            group.start_soon(check_threads.run, wait, f"key {number % 5}")
        with anyio.fail_after(60.0):
            while not refused:
                await anyio.sleep(0.01)
            assert await check_threads.run(lambda: "quick") == "quick"
        done.set()
    assert [problem.name for problem in refused] == ["unavailable"]
