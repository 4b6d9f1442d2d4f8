"""Sequences through the client for asyncio, on a real service."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from equimesh_client import AsyncClient, Weight
from equimesh_service import Settings, running


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("sequences")
    with running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")) as address:
        yield address


def front(x: Any, y: Any, moved: float) -> Any:
    return np.tanh(15.0 * (x + y / 2 - 0.6 - moved))


def test_the_same_with_asyncio(url: str) -> None:
    async def walk() -> None:
        async with AsyncClient(url) as client:
            sequence = await client.sequences.start("tanh(15*(x - 0.5))", 9)
            step = await sequence.step(front(sequence.x, sequence.y, 0.0), {"p": sequence.y})
            assert (step.number, sequence.x is step.x) == (1, True)
            assert np.abs(step.fields["p"] - step.y).max() < 1e-12
            assert (await sequence.mesh()).status == "succeeded"
            assert (step.status, step.velocity is None or step.velocity.shape) == ("succeeded", (9, 9, 2))
            assert step.certificate is not None
            weight = await sequence.step(monitor=Weight(rho=1 + sequence.x))
            assert (await client.sequences.get(sequence.id)).current.number == weight.number == 2
            assert [record.number async for record in client.sequences.list(limit=1)] == [2]
            await sequence.delete()

    asyncio.run(walk())
