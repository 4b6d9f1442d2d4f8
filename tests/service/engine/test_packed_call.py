"""Calls and outcomes as bytes."""

from __future__ import annotations

import pytest

from equimesh_service.engine.port import PackedCall, open_outcome, pack_error, pack_outcome
from service.engine.check_engine import add, fail


class Unsendable(Exception):
    """An exception that can be pickled and not be unpickled."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def unsendable() -> None:
    raise Unsendable("a", "b")


def out_of_memory() -> None:
    raise MemoryError


def test_results_and_exceptions_come_back() -> None:
    assert open_outcome(pack_outcome(PackedCall.of(add, 2, 3))) == 5
    with pytest.raises(ValueError, match="bad"):
        open_outcome(pack_outcome(PackedCall.of(fail, "bad")))
    with pytest.raises(RuntimeError, match="Unsendable: ab"):
        open_outcome(pack_outcome(PackedCall.of(unsendable)))
    with pytest.raises(RuntimeError, match="closed"):
        open_outcome(pack_error(RuntimeError("closed")))


def test_a_lack_of_memory_is_left_to_the_process() -> None:
    with pytest.raises(MemoryError):
        pack_outcome(PackedCall.of(out_of_memory))
