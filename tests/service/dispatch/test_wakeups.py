"""Waits for meshes: one query of the store for all, and each wakes at a change."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

import anyio
import pytest

from equimesh_service.dispatch.wakeups import END, Wakeups


class Looks:
    """A store of unfinished meshes that records its queries, and fails when a test says so."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []
        self.last: dict[str, int] = {}
        self.fails = False

    def __call__(self, names: Sequence[str]) -> Mapping[str, int]:
        self.asked.append(sorted(names))
        if self.fails:
            raise OSError("the database is down")
        return dict(self.last)


@pytest.mark.anyio
async def test_one_look_serves_all_waits_and_ends_those_whose_mesh_changed() -> None:
    looks, poll = Looks(), 0.05
    wakeups = Wakeups(looks, poll)
    names = [f"m-{number}" for number in range(100)]
    looks.last = dict.fromkeys(names, 7)
    told: dict[str, bool] = {}

    async def wait(name: str, seen: int | None) -> None:
        told[f"{name} {seen}"] = await wakeups.wait(name, 600.0, seen=seen)

    async def expect(*woken: str) -> None:
        """Some queries later, exactly these waits have ended."""
        number = len(looks.asked)
        with anyio.fail_after(50.0):
            while len(looks.asked) < number + 3 or len(told) < len(woken):
                await anyio.sleep(poll)
        assert told == dict.fromkeys(woken, True)

    async with anyio.create_task_group() as group:
        for name in names:
            group.start_soon(wait, name, 7)
        for seen in (6, END):
            group.start_soon(wait, "m-0", seen)
        group.start_soon(wait, "announced", None)
        await expect("m-0 6")
        looks.last["m-1"] = 8
        del looks.last["m-0"]  # it is finished, or gone
        await expect("m-0 6", "m-0 7", f"m-0 {END}", "m-1 7")
        wakeups.announce("m-2")
        await expect("m-0 6", "m-0 7", f"m-0 {END}", "m-1 7", "m-2 7")
        assert looks.asked[0] == sorted(names)  # one look for all of them
        group.cancel_scope.cancel()


@pytest.mark.anyio
async def test_a_wait_that_nothing_ends_is_false_and_then_nobody_looks() -> None:
    looks, poll = Looks(), 0.02
    looks.last = {"m-1": 7}
    wakeups = Wakeups(looks, poll)
    assert not await wakeups.wait("m-1", 5 * poll, seen=7)
    assert not await wakeups.wait("announced", 5 * poll, seen=None)
    await anyio.sleep(3 * poll)
    number = len(looks.asked)
    await anyio.sleep(5 * poll)
    assert len(looks.asked) == number


@pytest.mark.anyio
async def test_who_waits_wakes_when_the_store_fails_and_when_the_service_ends() -> None:
    looks = Looks()
    wakeups = Wakeups(looks, 0.01)
    looks.last = {"m-1": 1}
    looks.fails = True
    with anyio.fail_after(50.0):
        assert await wakeups.wait("m-1", 60.0, seen=1)
    looks.fails = False
    with anyio.fail_after(50.0):
        waiting = asyncio.create_task(wakeups.wait("m-1", 60.0, seen=1))
        await anyio.sleep(0.05)
        wakeups.close()
        assert await waiting
        assert await wakeups.wait("m-1", 60.0, seen=1)
