"""One definition for both clients: what is called, what the help says, and what an event loop may do meanwhile."""

from __future__ import annotations

import asyncio
import inspect
import pydoc
from collections.abc import AsyncIterator
from typing import Any, Generic, TypeVar, get_type_hints

import pytest

from equimesh_client import AsyncClient, AsyncMesh, Client, Mesh
from equimesh_client.client import AsyncMeshes, Meshes
from equimesh_client.operation import Awaiting, Blocking, each, finish, operation

Kind = TypeVar("Kind")


class Counting(Generic[Kind]):
    """Counts, and closes what it has opened."""

    def __init__(self) -> None:
        self.closed = False

    @operation
    async def next(self, number: int, *, by: int = 1) -> int:
        """The number after a number."""
        return number + by

    @operation
    async def all(self, last: int) -> AsyncIterator[int]:
        """The numbers up to the last one."""
        try:
            for number in range(last + 1):
                yield number
        finally:
            self.closed = True


class Now(Blocking, Counting[int]):
    """Plain methods."""


class Later(Awaiting, Counting[float]):
    """Coroutines."""


def test_a_definition_is_a_plain_method_and_a_coroutine() -> None:
    assert Now().next(1, by=2) == 3
    assert list(Now().all(3)) == [0, 1, 2, 3]

    async def later() -> list[int]:
        assert await Later().next(1, by=2) == 3
        return [number async for number in Later().all(3)]

    assert asyncio.run(later()) == [0, 1, 2, 3]
    assert (inspect.iscoroutinefunction(Now.next), inspect.iscoroutinefunction(Later.next)) == (False, True)
    assert inspect.isasyncgenfunction(Later.all)


def test_an_iterator_that_is_left_is_closed() -> None:
    now = Now()
    opened = Later.all(now, 3)  # held here, so that no collector closes it
    numbers = each(opened)
    assert next(numbers) == 0
    assert not now.closed
    numbers.close()  # type: ignore[attr-defined]
    assert now.closed


def test_what_waits_for_an_event_loop_is_refused() -> None:
    with pytest.raises(RuntimeError, match="waits for an event loop"):
        finish(asyncio.sleep(0))

    async def slow() -> Any:
        yield 1
        await asyncio.sleep(0)
        yield 2

    with pytest.raises(RuntimeError, match="waits for an event loop"):
        list(each(slow()))


def test_the_blocking_client_works_where_an_event_loop_runs(service: Any) -> None:
    async def notebook() -> list[str]:
        with Client(service.url) as client:
            client.generate("x", 5)
            return [mesh.status for mesh in client.meshes.list()]

    assert asyncio.run(notebook()) == ["succeeded"]


@pytest.mark.parametrize(("kind", "mesh"), [(Client, "Mesh"), (AsyncClient, "AsyncMesh")])
def test_help_and_signature_are_those_of_the_definition(kind: type, mesh: str) -> None:
    generate = kind.generate  # type: ignore[attr-defined]
    signature = inspect.signature(generate)
    assert [*signature.parameters][:4] == ["self", "u", "n", "initial"]
    assert signature.return_annotation == mesh
    assert (generate.__module__, generate.__qualname__) == (kind.__module__, f"{kind.__name__}.generate")
    text = pydoc.plain(pydoc.render_doc(kind))
    assert "generate(self, u: 'object' = None, n: 'int | tuple[int, int]' = 64" in text
    assert f"-> '{mesh}'" in text
    assert "``progress`` shows a bar" in text
    assert get_type_hints(generate)["return"].__name__ == mesh


def test_results_name_the_classes_of_the_client() -> None:
    returned = {
        method.__qualname__: inspect.signature(method).return_annotation
        for method in (Meshes.list, AsyncMeshes.list, Mesh.wait, AsyncMesh.wait, Mesh.events, Client.adapt)
    }
    assert returned == {
        "Meshes.list": "Iterator[Mesh]",
        "AsyncMeshes.list": "AsyncIterator[AsyncMesh]",
        "Mesh.wait": "Mesh",
        "AsyncMesh.wait": "AsyncMesh",
        "Mesh.events": "Iterator[Event]",
        "Client.adapt": "Adaptation[Mesh]",
    }
