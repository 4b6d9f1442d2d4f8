"""Which worker runs which part."""

from __future__ import annotations

import pytest

from equimesh import InputError
from equimesh_cluster.workers import WorkerFacts, place


def worker(address: str, threads: int = 1) -> WorkerFacts:
    return WorkerFacts(
        address=address, identity=address, host="h", threads=threads, versions={}, limit=0, used=0, free=0
    )


def test_a_worker_has_neighbours_and_not_more_parts_than_threads() -> None:
    workers = [worker("a", 2), worker("b", 1), worker("c", 4)]
    assert [one.address for one in place(3, workers)] == ["a", "b", "c"]
    assert [one.address for one in place(5, workers)] == ["a", "a", "b", "c", "c"]
    assert [one.address for one in place(7, workers)] == ["a", "a", "b", "c", "c", "c", "c"]
    assert [one.address for one in place(2, workers)] == ["a", "b"]


@pytest.mark.parametrize("count", [0, 4, -1])
def test_more_parts_than_threads_are_refused_with_the_largest_number(count: int) -> None:
    with pytest.raises(InputError, match=f"parts = {count}: .* 2 workers have 3 threads .* take 1 to 3 parts") as error:
        place(count, [worker("a", 2), worker("b")])
    assert error.value.field == "parts"


@pytest.mark.parametrize("count", [2.5, "3", True])
def test_parts_that_are_no_whole_number_are_refused(count: object) -> None:
    with pytest.raises(InputError, match=f"parts = {count!r}: a whole number") as error:
        place(count, [worker("a", 2), worker("b")])  # type: ignore[arg-type]
    assert error.value.field == "parts"
