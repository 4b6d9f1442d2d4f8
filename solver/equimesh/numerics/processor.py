"""The level of the processor that loops are compiled for, so that all machines of a level run the same code."""

import hashlib
import importlib.machinery
from functools import cache
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba
from numba.core import codegen, config, registry

# What a processor has to have for the code of a level; the first level that fits is taken.
LEVELS = {
    "x86-64-v3": ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("cx16", "popcnt", "sse3", "sse4.1", "sse4.2", "ssse3"),
}
# Parts of Numba whose types nobody has written down.
_codegen: Any = codegen
_config: Any = config
_registry: Any = registry
_llvm: Any = llvm


class Level(NamedTuple):
    """A level of processors: its name, and the ``processor`` and ``features`` that LLVM compiles for."""

    name: str
    processor: str
    features: str = ""


@cache
def level() -> Level:
    """The level of this processor; that of ``NUMBA_CPU_NAME`` where it is set; the processor itself without levels."""
    if _config.CPU_NAME is not None:
        return _named(_config.CPU_NAME, _config.CPU_FEATURES or "")
    machine = _llvm.get_process_triple().split("-")[0]
    if machine in ("aarch64", "arm64"):
        return Level("aarch64", "generic")
    if machine == "x86_64":
        here = _llvm.get_host_cpu_features()
        for name, needed in LEVELS.items():
            if all(here.get(feature) for feature in needed):
                return Level(name, name)
    return _named(_llvm.get_host_cpu_name(), _codegen.get_host_cpu_features())


@cache
def tag() -> str:
    """What machine code has to be made for to run here: system, Python, Numba, llvmlite and level of the processor."""
    python = importlib.machinery.EXTENSION_SUFFIXES[0].strip(".").rpartition(".")[0]
    vectors = "-svml" if _config.USING_SVML else ""  # Intel's library of vector functions, whose code calls it
    return f"{python}-numba{numba.__version__}-llvmlite{llvmlite.__version__}-{level().name}{vectors}"


class _LevelTarget(_registry.CPUTarget):  # type: ignore[misc]
    """Numba's target for processors, with code for the level in place of the processor of this machine.

    Types and functions are those of Numba's own target. Other functions of a program are compiled as always.
    """

    @property
    def typing_context(self) -> Any:
        return _registry.cpu_target.typing_context

    @property
    def target_context(self) -> Any:
        return _context()


class _LevelCodegen(_codegen.JITCPUCodegen):  # type: ignore[misc]
    def _get_host_cpu_name(self) -> str:
        return level().processor

    def _get_host_cpu_features(self) -> str:
        return level().features


TARGET: Any = _LevelTarget("cpu")
"""The target of the project's loops."""


@cache
def _context() -> Any:
    return _registry.cpu_target.target_context.subtarget(_internal_codegen=_LevelCodegen("equimesh.exec"))


def _named(processor: str, features: str) -> Level:
    digest = f"-{hashlib.sha256(features.encode()).hexdigest()[:8]}" if features else ""
    return Level(processor + digest, processor, features)
