"""Strict reading of plain documents: known keys, values of the right types, and errors with the path of the fault.

A *reader* takes a value and its path in the document, such as ``monitor.u``, and returns the object that the value
describes. :class:`Record`, :class:`ByKind` and :class:`ByKey` are readers of objects, made of the readers of their
members.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from inspect import Parameter, signature
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import describe_value

Reader: TypeAlias = Callable[[object, str], Any]
"""Takes a value and its path. Returns the described object, or raises an InputError whose field is the path."""
T = TypeVar("T", covariant=True)


@dataclass(frozen=True)
class Record(Generic[T]):
    """The reader of an object with known ``keys``: ``make`` takes what their readers return, by the same names.

    A key is required where the parameter of ``make`` has no default, so every default is that of the solver.
    """

    make: Callable[..., T]
    keys: Mapping[str, Reader]

    def __call__(self, given: object, path: str = "") -> T:
        """The result of ``make``; raises :class:`~equimesh.errors.InputError`, whose field is a path."""
        document = mapping(given, path)
        for key in document:
            if key not in self.keys:
                message = f"{_name(path)} has no key {key!r}; known are {_known(key, self.keys)}"
                raise InputError(message, field=joined(path, str(key)))
        for key in self._required:
            if key not in document:
                raise InputError(f"{_name(path)} needs the key '{key}'", field=joined(path, key))
        values = {key: read(document[key], joined(path, key)) for key, read in self.keys.items() if key in document}
        with within(path):
            return self.make(**values)

    @cached_property
    def _required(self) -> tuple[str, ...]:
        parameters = signature(self.make).parameters.items()
        return tuple(name for name, parameter in parameters if parameter.default is Parameter.empty)


@dataclass(frozen=True)
class Refusing(Generic[T]):
    """The reader of ``record``, with a sentence for each of some keys that it does not have."""

    record: Record[T]
    refused: Mapping[str, str]

    def __call__(self, given: object, path: str = "") -> T:
        """The result of the record."""
        for key in mapping(given, path):
            if key in self.refused:
                raise InputError(self.refused[key], field=joined(path, key))
        return self.record(given, path)


@dataclass(frozen=True)
class ByKind(Generic[T]):
    """The reader of an object whose key ``kind`` names one of ``records``, or is absent for the ``default``."""

    records: Mapping[str, Callable[[object, str], T]]
    default: str | None = None

    def __call__(self, given: object, path: str = "") -> T:
        """The result of the record of that kind for the other keys."""
        members = dict(mapping(given, path))
        kind = members.pop("kind", self.default)
        if not isinstance(kind, str) or kind not in self.records:
            shown = "missing" if kind is None else repr(kind)[:40]
            message = f"the kind of {_name(path)} is {shown}: choose one of {_known(kind, self.records)}"
            raise InputError(message, field=joined(path, "kind"))
        return self.records[kind](members, path)


@dataclass(frozen=True)
class ByKey(Generic[T]):
    """The reader of an object that is of the first of ``records`` whose name is one of its keys."""

    records: Mapping[str, Record[T]]

    def __call__(self, given: object, path: str = "") -> T:
        """The result of that record."""
        members = mapping(given, path) if isinstance(given, Mapping) else {}
        name = next((name for name in self.records if name in members), None)
        if name is None:
            message = f"{_name(path)} must be an object with one of the keys {_listed(self.records)}"
            raise InputError(message, field=path)
        return self.records[name](members, path)


def as_given(value: object, path: str) -> object:  # noqa: ARG001 - a reader
    """The value itself, which the solver checks when the object is built."""
    return value


def mapping(value: object, path: str) -> Mapping[Any, Any]:
    """An object."""
    if not isinstance(value, Mapping):
        raise _wrong(value, path, "an object")
    return value


def number(value: object, path: str) -> float:
    """A finite number, as a float."""
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        try:
            if math.isfinite(value):
                return float(value)
        except OverflowError:
            pass
        raise InputError(f"{_name(path)} must be a finite number", field=path)
    raise _wrong(value, path, "a number")


def whole(value: object, path: str) -> int:
    """A whole number."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool):
        raise _wrong(value, path, "a whole number")
    return int(value)


def flag(value: object, path: str) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise _wrong(value, path, "true or false")
    return value


def text(value: object, path: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise _wrong(value, path, "a text")
    return value


def either(word: str, read: Reader) -> Reader:
    """The reader of ``word``, or of what ``read`` takes."""
    return lambda value, path: word if isinstance(value, str) and value == word else read(value, path)


def optional(read: Reader) -> Reader:
    """The reader of null, or of what ``read`` takes."""
    return lambda value, path: None if value is None else read(value, path)


def several(read: Reader) -> Reader:
    """The reader of a list, as a tuple of what ``read`` returns of its items."""

    def items(value: object, path: str) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            raise _wrong(value, path, "a list")
        return tuple(read(item, joined(path, str(number))) for number, item in enumerate(value))

    return items


def joined(path: str, name: str) -> str:
    """The path of a member."""
    return f"{path}.{name}" if path and name else path or name


@contextmanager
def within(path: str) -> Iterator[None]:
    """Errors raised inside get a field that is a path of the document.

    A field of the solver begins at the object that is built, such as ``a``, or with its name, such as ``domain.x``.
    """
    try:
        yield
    except InputError as error:
        first, _, rest = error.field.partition(".")
        error.field = joined(path, rest if path and first == path.rpartition(".")[2] else error.field)
        raise


def _wrong(value: object, path: str, needed: str) -> InputError:
    return InputError(f"{_name(path)} is {describe_value(value)}: {needed} is needed", field=path)


def _name(path: str) -> str:
    return path or "the document"


def _known(given: object, names: Iterable[str]) -> str:
    """The known names, and the one nearest to ``given``."""
    nearest = get_close_matches(given, names, 1) if isinstance(given, str) else []
    return _listed(names) + "".join(f"; did you mean '{name}'?" for name in nearest)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
