"""Too little memory is said before the start."""

from __future__ import annotations

import re

import pytest

from equimesh import Grid
from equimesh.cluster import ClusterError
from equimesh.cluster.memory import BYTES_A_POINT, check_memory, memory_of_part
from equimesh.cluster.worker_facts import WorkerFacts

GRID = Grid(n_xi=4001, n_eta=1000)
NEEDED = BYTES_A_POINT * 1003 * 1000  # of each of four parts


def worker(address: str, host: str, *, limit: int = 0, used: int = 0, free: int = 10 * NEEDED) -> WorkerFacts:
    return WorkerFacts(
        address=address, identity="", host=host, threads=2, versions={}, limit=limit, used=used, free=free
    )


def test_a_part_takes_65_bytes_for_each_point_of_its_rows() -> None:
    assert memory_of_part(GRID, 4) == NEEDED
    assert memory_of_part(GRID, 1) == 65 * 4003 * 1000


def test_workers_with_enough_memory_are_taken() -> None:
    check_memory(GRID, [worker(name, name) for name in "abcd"])
    limit = int((NEEDED + 1000) / 0.95) + 1
    check_memory(GRID, [worker(name, name, limit=limit, used=1000) for name in "abcd"])


@pytest.mark.parametrize("used", [0, 10_000_000])
def test_a_limit_that_is_too_low_is_named_with_both_numbers(used: int) -> None:
    low = worker("tcp://low:1", "c", limit=NEEDED, used=used)
    left = f"{(0.95 * NEEDED - used) / 1e9:.3g} GB left of its memory limit"
    text = f"the worker tcp://low:1 has {left}, and a part of 4001 x 1000 points take {NEEDED / 1e9:.3g} GB"
    with pytest.raises(ClusterError, match=re.escape(text)):
        check_memory(GRID, [worker("a", "a"), worker("b", "b"), low, worker("d", "d")])


def test_parts_of_one_worker_and_workers_of_one_machine_are_added() -> None:
    one = worker("a", "a", limit=2 * NEEDED)
    with pytest.raises(ClusterError, match="and 2 parts of"):
        check_memory(GRID, [one, one, worker("c", "c"), worker("d", "d")])
    small = [worker(name, "host", free=3 * NEEDED) for name in "abcd"]
    check_memory(GRID, [*small[:3], worker("d", "other")])
    with pytest.raises(ClusterError, match=r"the machine host has .* free, and 4 parts of"):
        check_memory(GRID, small)
