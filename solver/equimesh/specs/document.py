"""Strict reading of documents: known keys, values of the right types, and errors with the path of the fault.

A *reader* takes a value and its path in the document, such as ``monitor.u``, and returns the object that the value
describes. :class:`Reading` reads the documents of :mod:`equimesh_schema`, by the types of their fields.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import describe_value
from equimesh_schema.document import Document, OneOf, Words, is_whole, key_of, required_of, types_of

Reader: TypeAlias = Callable[[object, str], Any]
"""Takes a value and its path. Returns the described object, or raises an InputError whose field is the path."""


Makers: TypeAlias = Mapping[Any, Callable[..., Any]]
"""What makes objects of the solver, by the classes of documents."""


@dataclass(frozen=True)
class Reading:
    """Makes objects of the solver from documents.

    ``makers`` have what makes an object of a class of documents: it takes the values that are given, and
    has the defaults of the solver. ``readers`` read unions of documents in another way. Errors are
    :class:`~equimesh.errors.InputError`, whose field is a path.
    """

    makers: Makers
    readers: Mapping[OneOf, Reader] = field(default_factory=dict)

    def record(self, document: type[Document], given: object, path: str = "") -> Any:
        """The object of a document without its ``kind``."""
        members = document.completed(mapping(given, path))
        names = _names_of(document)
        for key in members:
            if key in document.REFUSED:
                raise InputError(document.REFUSED[key], field=joined(path, key))
        for key in members:
            if key not in names:
                message = f"{_name(path)} has no key {key!r}; known are {_known(key, names)}"
                raise InputError(message, field=joined(path, str(key)))
        for key in _needed_of(document):
            if key not in members:
                raise InputError(f"{_name(path)} needs the key '{key}'", field=joined(path, key))
        values = {
            name: self.value(kind, members[key], joined(path, key))
            for key, (name, kind) in names.items()
            if key in members
        }
        with within(path), _keys_in_place_of_names(document):
            return self.makers[document](**values)

    def one_of(self, documents: OneOf, given: object, path: str) -> Any:
        """The object of one of several documents, which the ``kind`` names, or the first known key."""
        if documents.fault == "kind":
            return self._by_kind(documents, given, path)
        name = documents.tag(given) if isinstance(given, Mapping) else None
        if not isinstance(name, str):
            message = f"{_name(path)} must be an object with one of the keys {_listed(documents.documents)}"
            raise InputError(message, field=path)
        return self.record(documents.documents[name], given, path)

    def _by_kind(self, documents: OneOf, given: object, path: str) -> Any:
        members = dict(mapping(given, path))
        kind = members.pop("kind", documents.default)
        if not isinstance(kind, str) or kind not in documents.documents:
            shown = "missing" if kind is None else repr(kind)[:40]
            message = f"the kind of {_name(path)} is {shown}: choose one of {_known(kind, documents.documents)}"
            raise InputError(message, field=joined(path, "kind"))
        return self.record(documents.documents[kind], members, path)

    def value(self, kind: Any, given: object, path: str) -> Any:
        """The value of a field of the type ``kind``. What objects of the solver check is taken as it is given."""
        form = _form_of(kind)
        if form.mark is not None:
            read = self.readers.get(form.mark)
            return self.one_of(form.mark, given, path) if read is None else read(given, path)
        if form.members is not None:
            other = form.members.other(given)
            return given if other is None else self.value(other, given, path)
        if form.item is not None:
            item = form.item
            return several(lambda one, at: self.one_of(item, one, at), given, path)
        if form.document is not None:
            return self.record(form.document, given, path)
        return given if form.plain is None else form.plain(given, path)


@dataclass(frozen=True)
class _Members:
    """The types of a union: null, words, and others."""

    has_null: bool
    words: frozenset[Any]
    others: tuple[Any, ...]

    @classmethod
    def of(cls, kinds: tuple[Any, ...]) -> "_Members":
        words = frozenset(word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind))
        others = tuple(kind for kind in kinds if get_origin(kind) is not Literal and kind is not NoneType)
        return cls(NoneType in kinds, words, others)

    def other(self, given: object) -> Any:
        """The type of which a value is to be read; None for null, for a word, and where there are several types."""
        if (given is None and self.has_null) or (isinstance(given, str) and given in self.words):
            return None
        only_word = self.words and self.others and self.others[0] is not float
        return None if len(self.others) != 1 or only_word else self.others[0]


@dataclass(frozen=True)
class _Form:
    """How values of a type are read: the first of these that is there says it, else a value is taken as it is."""

    mark: OneOf | None = None
    members: _Members | None = None
    item: OneOf | None = None
    document: type[Document] | None = None
    plain: Reader | None = None


@cache  # types are few, and to look into one takes longer than to read most values
def _form_of(kind: Any) -> _Form:
    marks = getattr(kind, "__metadata__", ())
    if get_origin(kind) is Annotated:
        (kind, *_) = get_args(kind)
    mark = next((one for one in marks if isinstance(one, OneOf)), None)
    if mark is not None:
        return _Form(mark=mark)
    if any(isinstance(one, Words) for one in marks):
        return _Form()
    if get_origin(kind) in (Union, UnionType):
        return _Form(members=_Members.of(get_args(kind)))
    if get_origin(kind) is list and (item := one_of_item(kind)) is not None:
        return _Form(item=item)
    if isinstance(kind, type) and issubclass(kind, Document):
        return _Form(document=kind)
    return _Form(plain=PLAIN.get(get_origin(kind) or kind))


def _find_names(document: type[Document]) -> Mapping[str, tuple[str, Any]]:
    return {key_of(document, name): (name, kind) for name, kind in types_of(document).items() if name != "kind"}


def _find_needed(document: type[Document]) -> tuple[str, ...]:
    return tuple(key for name in required_of(document) if (key := key_of(document, name)) in _names_of(document))


_names_of: Callable[[type[Document]], Mapping[str, tuple[str, Any]]] = cache(_find_names)  # type: ignore[assignment]
"""The names and types of the fields of a document by their keys, without its ``kind``."""
_needed_of: Callable[[type[Document]], tuple[str, ...]] = cache(_find_needed)  # type: ignore[assignment]
"""The keys that a document has to have, without its ``kind``."""


def one_of_item(kind: Any) -> OneOf | None:
    """The documents of the items of a list."""
    marks = getattr(get_args(kind)[0], "__metadata__", ())
    return next((one for one in marks if isinstance(one, OneOf)), None)


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
    if not is_whole(value):
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


def several(read: Reader, value: object, path: str) -> tuple[Any, ...]:
    """What ``read`` returns of the items of a list."""
    if not isinstance(value, list | tuple):
        raise _wrong(value, path, "a list")
    return tuple(read(item, joined(path, str(number))) for number, item in enumerate(value))


PLAIN: Mapping[Any, Reader] = {float: number, int: whole, bool: flag, dict: mapping}
"""The readers of plain values by their types. Texts are checked when they are used."""


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


@contextmanager
def _keys_in_place_of_names(document: type[Document]) -> Iterator[None]:
    try:
        yield
    except InputError as error:
        error.field = document.JSON_NAMES.get(error.field, error.field)
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
