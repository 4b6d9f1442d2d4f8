"""What only the client for asyncio does; the tests of the blocking client run with both."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from equimesh_client import AsyncClient


def test_a_canceled_task_cancels_its_mesh(service: Any) -> None:
    async def cancel() -> None:
        async with AsyncClient(service.url) as client:
            task = asyncio.create_task(client.generate("x", 5, label="hang"))
            while "m0" not in service.meshes:
                await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(asyncio.wait_for(cancel(), 30))
    assert service.meshes["m0"]["status"] == "canceled"


def test_meshes_are_made_at_the_same_time(service: Any) -> None:
    async def generate() -> set[str]:
        async with AsyncClient(service.url) as client:
            meshes = await asyncio.gather(*(client.generate("x", 5, label="slow") for _ in range(4)))
            return {mesh.id for mesh in meshes}

    assert len(asyncio.run(asyncio.wait_for(generate(), 30))) == 4
