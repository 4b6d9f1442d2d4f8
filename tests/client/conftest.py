"""The fake service, and one face for the blocking client and its twin for asyncio."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest

from client.fake_service import FakeService, Fault
from equimesh_client import AsyncClient, AsyncMesh, Client, RetryPolicy

QUICK = RetryPolicy(retries=3, first=0.01, longest=0.05)


class Blocking:
    """Makes an object of the asynchronous client look like its blocking twin."""

    def __init__(self, runner: asyncio.Runner, target: Any) -> None:
        self._runner = runner
        self._target = target

    def __getattr__(self, name: str) -> Any:
        if isinstance(self._target, AsyncMesh) and name in ("points", "cells", "sides", "boundary", "x", "y", "u"):
            return getattr(self.arrays(), name)
        value = getattr(self._target, name)
        if name in ("quality", "convergence"):
            return self._wrapped(value())
        if callable(value):
            return lambda *args, **kwargs: self._wrapped(value(*args, **kwargs))
        return self._wrapped(value)

    def _wrapped(self, value: Any) -> Any:
        if inspect.iscoroutine(value):
            value = self._runner.run(value)
        if isinstance(value, AsyncIterator):
            return self._iterate(value)
        if type(value).__name__ in ("AsyncMesh", "AsyncMeshes", "AsyncSamplesStore", "AsyncSequence", "AsyncSequences"):
            return value_of(self, value)
        return value

    def _iterate(self, values: AsyncIterator[Any]) -> Iterator[Any]:
        async def step() -> Any:
            return await anext(values, None)

        while (value := self._runner.run(step())) is not None:
            yield self._wrapped(value)


def value_of(parent: Blocking, value: Any) -> Any:
    """The parent itself when a method returned it, otherwise a new face."""
    return parent if value is parent._target else Blocking(parent._runner, value)


Connect = Callable[..., Any]


@pytest.fixture(params=["sync", "async"])
def connect(request: pytest.FixtureRequest) -> Iterator[Connect]:
    """Makes clients of one kind or the other, quick to retry, and closes them."""
    opened: list[Any] = []
    runner = asyncio.Runner()

    def make(url: str, **options: Any) -> Any:
        options = {"retries": QUICK, "timeout": 5.0, **options}
        if request.param == "sync":
            client: Any = Client(url, **options)
        else:

            async def open_client() -> AsyncClient:
                return AsyncClient(url, **options)

            client = Blocking(runner, runner.run(open_client()))
        opened.append(client)
        return client

    with runner:
        yield make
        for client in opened:
            client.close()


@pytest.fixture
def service() -> Iterator[Any]:
    """A fresh fake service."""
    fake = FakeService()
    yield fake
    fake.close()


@pytest.fixture
def fault() -> Any:
    """The class of faults."""
    return Fault
