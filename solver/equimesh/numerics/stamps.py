"""The stamp of a compiled loop: it changes with every source that the machine code is made of."""

import hashlib
import marshal
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

# Values that Numba writes into machine code where a loop names them.
_CONSTANTS = (bool, int, float, complex, str, bytes, type(None), np.generic)


def note(function: Callable[..., Any]) -> None:
    """Take the digest of the file of a function now, when it was just imported: the file may be edited later."""
    _digest_of(function.__code__)


@cache
def stamp_of(function: Callable[..., Any]) -> str:
    """The digest of the file of a function, of the files of all compiled functions it calls, and of named constants.

    The files of functions that those call belong to it, and so on. Two environments with equal sources have equal
    stamps, wherever they are.
    """
    found, seen, rest = set[str](), set[Callable[..., Any]](), [function]
    while rest:
        one = rest.pop()
        if one not in seen:
            seen.add(one)
            parts, called = _parts(one)
            found |= parts
            rest += called
    return hashlib.sha256("\n".join(sorted(found)).encode()).hexdigest()


@cache
def _parts(function: Callable[..., Any]) -> tuple[frozenset[str], tuple[Callable[..., Any], ...]]:
    """The digests of what a function itself is made of, and the compiled functions that it names."""
    parts, called = {_digest_of(function.__code__)}, []
    for name, value in _named(function):
        if isinstance(value, Dispatcher):
            called.append(value.py_func)
        elif _is_constant(value):
            parts.add(f"{name} {type(value).__name__} {value!r}")
        elif isinstance(value, np.ndarray):
            parts.add(f"{name} {value.dtype.str} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
    return frozenset(parts), tuple(called)


def _named(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """The globals and variables of outer functions that a function names, and what it names of our own modules."""
    code = function.__code__
    names = set(_names(code))
    values = {name: function.__globals__[name] for name in names if name in function.__globals__}
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        values[name] = cell.cell_contents
    for name, value in values.items():
        yield name, value
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0].startswith("equimesh"):
            for inner in names & vars(value).keys():
                yield f"{name}.{inner}", vars(value)[inner]


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    return isinstance(value, _CONSTANTS)


def _digest_of(code: CodeType) -> str:
    """The digest of the file of a function; that of its code where there is no file, as in a notebook."""
    try:
        return _digest_of_file(code.co_filename)
    except OSError:
        return hashlib.sha256(marshal.dumps(code)).hexdigest()


@cache
def _digest_of_file(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
