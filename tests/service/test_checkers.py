"""Checks of what clients send: slow ones, which wait for a worker, do not hold up the quick ones of others."""

from __future__ import annotations

import threading

import anyio
import pytest

from equimesh_service.checkers import Checkers


@pytest.mark.anyio
async def test_a_check_that_waits_for_a_worker_makes_room() -> None:
    checkers, done, waits = Checkers(threads=1), threading.Event(), threading.Event()

    def slow() -> None:
        with checkers.aside():
            waits.set()
            done.wait(20.0)

    async with anyio.create_task_group() as group:
        group.start_soon(checkers.run, slow)
        group.start_soon(checkers.run, slow)
        with anyio.fail_after(10.0):
            while not await checkers.run(waits.is_set):
                pass
        done.set()
    busy = threading.Event()
    async with anyio.create_task_group() as group:  # afterwards there is as much room as before
        group.start_soon(checkers.run, busy.wait, 20.0)
        await anyio.sleep(0.05)
        with anyio.move_on_after(0.2) as scope:
            await checkers.run(bool)
        assert scope.cancelled_caught
        busy.set()
