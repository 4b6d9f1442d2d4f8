"""The level of the processor: the highest one whose every feature is here."""

from __future__ import annotations

from collections.abc import Iterator

import llvmlite.binding as llvm
import pytest
from numba.core import codegen, config
from numba.core.registry import cpu_target

from equimesh.numerics.processor import LEVELS, TARGET, level, tag


@pytest.fixture(autouse=True)
def _anew() -> Iterator[None]:
    level.cache_clear(), tag.cache_clear()
    yield
    level.cache_clear(), tag.cache_clear()


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
