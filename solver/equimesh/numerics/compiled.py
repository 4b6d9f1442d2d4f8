"""Compilation of the project's loops to machine code, and how many of them are compiled."""

import pickle
from collections.abc import Callable
from typing import Any, NamedTuple, ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


# Flags that let the compiler use vector instructions. Results still do not change from run to run.
FAST_MATH = {"contract", "nsz", "arcp", "reassoc", "nnan", "ninf"}
# Every loop of the modules that were imported; not those that are compiled inside their callers.
_loops: list[Any] = []


class Compiled(NamedTuple):
    """How many loops are ``compiled``, in this process or on disk for this processor, ``of`` how many."""

    compiled: int
    of: int


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, cached on disk if a folder can be written; holds no interpreter lock."""
    return _listed(_compile(function, fastmath=False))


def vectorised(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`compiled`, for loops whose sums may be reordered, and whose results are never tested for NaN."""
    return _listed(_compile(function, fastmath=FAST_MATH))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`vectorised`, for a part of such a loop: compiled as if it were written inside its caller."""
    return _compile(function, fastmath=FAST_MATH, inline="always")


def count_compiled() -> Compiled:
    """How many of the project's loops are compiled now, also by other processes; takes a few milliseconds."""
    return Compiled(sum(map(_is_compiled, _loops)), len(_loops))


def is_loop(machine_code: Any) -> bool:
    """Whether this is one of the project's loops, and no function that a user of the package compiles."""
    return any(machine_code is loop for loop in _loops)


def cache_folder() -> str | None:
    """The folder in which the machine code of the first loop is kept; None where no folder can be written."""
    folder: str | None = _loops[0]._cache.cache_path if _loops else None
    return folder


def _listed(machine_code: Callable[P, R]) -> Callable[P, R]:
    if getattr(machine_code, "__module__", "").startswith("equimesh."):
        _loops.append(machine_code)
    return machine_code


def _is_compiled(loop: Any) -> bool:
    if loop.overloads:
        return True
    file = getattr(loop._cache, "_cache_file", None)  # Numba has no public way to it; absent without a folder
    if file is None:
        return False
    try:
        kept = file._load_index()
    except (OSError, EOFError, ValueError, pickle.UnpicklingError):  # it cannot be read, and is made anew
        return False
    processor = loop.targetctx.codegen().magic_tuple()
    return any(key[1] == processor for key in kept)


def _compile(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    options |= {"nogil": True, "error_model": "numpy"}
    try:
        machine_code: Callable[P, R] = njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no folder that it may write to
        machine_code = njit(**options)(function)
    return machine_code
