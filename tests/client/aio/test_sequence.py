"""Sequences through the client for asyncio, on a real service."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import AsyncClient, MeshFile, Weight
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


def test_blocks_with_asyncio(url: str, tmp_path: Path) -> None:
    vertices = {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1], "e": [2, 0], "f": [2, 1]}
    corners = (["a", "b", "c", "d"], ["b", "e", "f", "c"])
    document = {"vertices": vertices, "blocks": [{"corners": list(four), "cells": [5, 5]} for four in corners]}
    (tmp_path / "two.json").write_text(json.dumps(document))
    domain = MeshFile(file=tmp_path / "two.json")

    async def walk() -> None:
        async with AsyncClient(url) as client:
            sequence = await client.sequences.start("tanh(5*(x - 0.9))", domain=domain)
            step = await sequence.step("tanh(5*(x - t))", {"p": sequence.y}, t=0.95)
            assert (step.number, step.x.shape) == (1, (66,))
            np.testing.assert_allclose(step.fields["p"], step.y, atol=1e-12)
            found = await client.adapt(lambda mesh: np.tanh(5 * (mesh.x - 0.9)), domain=domain, rounds=1)
            assert found.estimate < 0.8 * found.rounds[0].estimate

    asyncio.run(walk())
