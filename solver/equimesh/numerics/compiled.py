"""Compilation of the project's loops to machine code."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


# Flags that let the compiler use vector instructions. Results still do not change from run to run.
FAST_MATH = {"contract", "nsz", "arcp", "reassoc", "nnan", "ninf"}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, cached on disk if a folder can be written; holds no interpreter lock."""
    return _compile(function, fastmath=False)


def vectorised(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`compiled`, for loops whose sums may be reordered, and whose results are never tested for NaN."""
    return _compile(function, fastmath=FAST_MATH)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`vectorised`, for a part of such a loop: compiled as if it were written inside its caller."""
    return _compile(function, fastmath=FAST_MATH, inline="always")


def _compile(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    options |= {"nogil": True, "error_model": "numpy"}
    try:
        machine_code: Callable[P, R] = njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no folder that it may write to
        machine_code = njit(**options)(function)
    return machine_code
