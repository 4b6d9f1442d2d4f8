"""The level of the processor: the highest one whose every feature is here. And what loops are compiled to."""

from __future__ import annotations

import gc
import operator
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
import pytest
from numba import types
from numba.core import codegen, config, event
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys

from equimesh.numerics.compiled import compiled
from equimesh.numerics.machine_code import find_folder
from equimesh.numerics.processor import LEVELS, TARGET, level, tag


@pytest.fixture(autouse=True)
def _anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("EQUIMESH_CACHE_DIR", str(tmp_path))
    level.cache_clear(), tag.cache_clear(), find_folder.cache_clear()
    yield
    level.cache_clear(), tag.cache_clear(), find_folder.cache_clear()


@pytest.mark.parametrize(
    ("missing", "expected"),
    [("", "x86-64-v3"), ("avx2", "x86-64-v2"), ("fma", "x86-64-v2"), ("sse4.2", "x86-64-v3"), ("sse3 bmi", "old")],
)
def test_the_level_has_every_feature(monkeypatch: pytest.MonkeyPatch, missing: str, expected: str) -> None:
    here = {feature: feature not in missing.split() for needed in LEVELS.values() for feature in needed}
    monkeypatch.setattr(config, "CPU_NAME", None)
    monkeypatch.setattr(llvm, "get_process_triple", lambda: "x86_64-unknown-linux-gnu")
    monkeypatch.setattr(llvm, "get_host_cpu_features", lambda: here)
    monkeypatch.setattr(llvm, "get_host_cpu_name", lambda: "old")
    monkeypatch.setattr(codegen, "get_host_cpu_features", lambda: "")
    assert level().name == expected
    assert f"-{expected}" in tag()


def test_all_64_bit_arm_processors_are_of_one_level(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CPU_NAME", None)
    monkeypatch.setattr(llvm, "get_process_triple", lambda: "aarch64-unknown-linux-gnu")
    assert level() == ("aarch64", "generic", "")


def test_a_processor_that_is_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CPU_NAME", "x86-64-v2")
    monkeypatch.setattr(config, "CPU_FEATURES", None)
    assert level() == ("x86-64-v2", "x86-64-v2", "")
    level.cache_clear()
    monkeypatch.setattr(config, "CPU_FEATURES", "+avx")
    assert level()[1:] == ("x86-64-v2", "+avx")
    assert level().name.startswith("x86-64-v2-")


def test_code_is_made_for_the_level_and_other_functions_for_the_processor() -> None:
    ours, general = TARGET.target_context, cpu_target.target_context
    assert ours.codegen().magic_tuple()[1:] == level()[1:]
    assert general.codegen().magic_tuple()[1] == (config.CPU_NAME or llvm.get_host_cpu_name())


class Two(NamedTuple):
    """Two arrays for a loop, and rows of them."""

    one: np.ndarray
    other: np.ndarray
    rows: np.ndarray


@compiled
def halves(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 0.5 * values, values[1:]


def of_parts(two: Two) -> float:
    again = Two(two.other, two.one, two.rows)
    rows = again.one.T if again.one.shape[0] == 3 else again.one
    first, (_, last) = rows[0], (rows[1, 1:], again.other[-1])
    total = 0.0
    for j in range(1, first.shape[0]):
        total += first[j] * last[j]
    return total


def of_a_new_array(two: Two) -> float:
    work = np.empty(two.one.shape[0])
    for i in range(work.shape[0]):
        work[i] = two.one[i, 1]
    return work[0] + work[1]


def of_a_result(two: Two) -> float:
    made, part = halves(two.one[0])
    return made[0] + part[0]


def of_a_difference(two: Two) -> float:
    return (two.one[0] - two.other[0])[1]


def of_chosen_rows(two: Two) -> float:
    return two.one[two.rows][0, 1]


def of_each_row(two: Two) -> float:
    total = 0.0
    for row in two.one:
        total += row[1]
    return total


def of_a_list(two: Two) -> float:
    rows = [two.one[0], two.other[0]]
    return rows[1][1]


@pytest.mark.parametrize(
    ("loop", "counts"),
    [
        (of_parts, False),
        (of_a_new_array, True),
        (of_a_result, True),
        (of_a_difference, True),
        (of_chosen_rows, True),
        (of_each_row, True),
        (of_a_list, True),
    ],
)
def test_references_are_counted_where_arrays_are_made_and_none_is_lost(
    loop: Callable[[Two], float], counts: bool
) -> None:
    two = Two(np.arange(9.0).reshape(3, 3), 1.0 + np.arange(9.0).reshape(3, 3), np.array([1, 0]))
    machine_code: Any = compiled(loop)
    assert machine_code(two) == loop(two)
    (found,) = machine_code.overloads.values()
    wrapper = found.library.get_function(found.fndesc.llvm_cpython_wrapper_name)
    assert ("NRT_adapt_ndarray_from_python" in str(wrapper)) is counts
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        for _ in range(10):
            machine_code(two)
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert (after.alloc > before.alloc) is counts
    assert after.alloc - before.alloc == after.free - before.free


def test_an_operator_is_looked_for_once_and_found_as_by_numba() -> None:
    rows, typing = types.Array(types.float64, 2, "C"), TARGET.typing_context
    for operation in (operator.add, operator.truediv, operator.lt, operator.getitem):
        for pair in ((types.int64, types.float64), (rows, types.int64), (rows, rows), (types.literal(2), types.int64)):
            if operation is not operator.getitem or pair[0] is rows is not pair[1]:
                found = typing.resolve_function_type(operation, pair, {})
                assert found == cpu_target.typing_context.resolve_function_type(operation, pair, {})
                assert typing.resolve_function_type(operation, pair, {}) is found
    assert typing.resolve_value_type(operator.add) is typing.resolve_value_type(operator.add)


class During(event.Listener):
    """Whether garbage was collected when passes of Numba began."""

    def __init__(self) -> None:
        self.seen = set[bool]()

    def on_start(self, _: Any) -> None:
        self.seen.add(gc.isenabled())

    def on_end(self, _: Any) -> None: ...


@pytest.mark.parametrize("is_collected", [True, False])
def test_garbage_is_not_collected_while_loops_are_compiled(is_collected: bool) -> None:
    with event.install_listener("numba:run_pass", During()) as during:
        try:
            (gc.enable if is_collected else gc.disable)()
            compiled(lambda values: halves(values)[0][0])(np.ones(3))
            assert gc.isenabled() is is_collected
        finally:
            gc.enable()
    assert during.seen == {False}
