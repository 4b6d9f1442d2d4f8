"""Requests and answers as dataclasses: what their fields hold, and their JSON.

Code that validates with pydantic can make a ``TypeAdapter`` of a document: the classes here answer what pydantic asks,
as plain dictionaries, without importing it.
"""

from __future__ import annotations

import ast
import inspect
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache, wraps
from itertools import pairwise
from numbers import Integral, Real
from pathlib import PurePath
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Self, TypeAlias, TypeGuard, TypeVar, get_args, get_origin, get_type_hints

# Answers as JSON and back: one codec for all dataclasses of this package.

Json: TypeAlias = dict[str, Any]
T = TypeVar("T")
C = TypeVar("C", bound=Callable[..., Any])


class NullForNan:
    """A number that is nan where it is not known, and null in JSON."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Json:
        return {"type": "nullable", "schema": handler(source)}


Number: TypeAlias = Annotated[float, NullForNan()]


class Answer:
    """The base class of what is answered: dataclasses whose fields are the keys of a JSON object.

    A reader takes what it knows and leaves out the rest, so that a client reads the answers of older and newer
    services.
    """

    JSON_NAMES: ClassVar[Mapping[str, str]] = {}
    """The keys of fields whose names differ from them."""
    __pydantic_config__: ClassVar[Mapping[str, Any]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        names = cls.JSON_NAMES
        cls.__pydantic_config__ = {
            "alias_generator": lambda name: names.get(name, name),
        }

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Json:
        # Whoever asks for a schema reads the sources: pydantic would read them for each class that is imported.
        found: Json = handler(schema)
        properties = handler.resolve_ref_schema(found)["properties"]
        for name, text in docs_of(cls).items():
            properties[cls.JSON_NAMES.get(name, name)]["description"] = text
        return found

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Self:
        """The answer in JSON. A number that is absent or null is nan, another value that is absent is empty."""
        values = {}
        for field in fields(cls):  # type: ignore[arg-type]
            name = cls.JSON_NAMES.get(field.name, field.name)
            is_optional = field.default is not MISSING or field.default_factory is not MISSING
            if record.get(name) is not None or not is_optional:
                values[field.name] = _read(_types(cls)[field.name], record.get(name))
        return cls(**values)

    def to_json(self) -> Json:
        """The answer as plain Python data, ready for JSON; a number that is not finite is None."""
        return {self.JSON_NAMES.get(name, name): _write(getattr(self, name)) for name in _types(type(self))}


def _hints_of(cls: type[Any]) -> Mapping[str, Any]:
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


_types: Callable[[type[Any]], Mapping[str, Any]] = lru_cache(_hints_of)  # type: ignore[assignment]
"""The types of the fields of a dataclass."""


def _read(kind: Any, value: Any) -> Any:
    """``value`` of JSON as a value of the type ``kind``."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is UnionType:  # with None
        return None if value is None else _read(next(one for one in arguments if one is not NoneType), value)
    if kind is float:
        return real_or_nan(value)
    if origin is tuple:
        (item, *_) = arguments
        return tuple(_read(item, one) for one in value or ())
    if isinstance(kind, type) and is_dataclass(kind) and issubclass(kind, Answer):
        return kind.from_json(value)
    if origin is Mapping or kind is Mapping:
        return dict(value or {})
    return kind(value or kind()) if kind in (str, int, bool) else value


def _write(value: Any) -> Any:
    if isinstance(value, Answer):
        return value.to_json()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if is_whole(value):
        return int(value)  # of NumPy, too
    if isinstance(value, Mapping):
        return {name: _write(member) for name, member in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_write(member) for member in value]
    return str(value) if isinstance(value, str) else value


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is a whole number, of Python or of NumPy; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value is a real number, of Python or of NumPy; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def hinted(**hints: str) -> Callable[[C], C]:
    """A decorator of a function or a class: arguments with these names are refused with what to give in their place.

    The decorated one raises :class:`TypeError`, as without it.
    """

    def decorated(made: C) -> C:
        call: Callable[..., Any] = vars(made)["__init__"] if isinstance(made, type) else made

        @wraps(call)
        def hinting(*arguments: Any, **given: Any) -> Any:
            for name in given.keys() & hints.keys():
                raise TypeError(f"{made.__name__}() has no argument {name!r}; {hints[name]}")
            return call(*arguments, **given)

        @wraps(call)
        async def awaiting(*arguments: Any, **given: Any) -> Any:
            return await hinting(*arguments, **given)

        if not isinstance(made, type):
            return awaiting if inspect.iscoroutinefunction(made) else hinting  # type: ignore[return-value]
        made.__init__ = hinting  # type: ignore[misc]
        return made

    return decorated


def real_or_nan(value: Any) -> float:
    """The value as a float. NaN where it is absent or not a number."""
    return float(value) if isinstance(value, int | float) else math.nan


CoreSchema: TypeAlias = dict[str, Any]
TAG = "\x00"
"""The first character of tags of unions, so that they can be removed from a pointer."""
MAX_PARAMETERS = 64
"""The most parameters of an expression."""


class Document:
    """The base class of JSON objects without further keys, whose values have exactly the types of the fields.

    A field that is required although it has a default is in ``NEEDED``: in Python it is given later.
    """

    JSON_NAMES: ClassVar[Mapping[str, str]] = {}
    """The keys of fields whose names differ from them."""
    NEEDED: ClassVar[tuple[str, ...]] = ()
    """Keys that a document has to have, although their fields have a default."""
    REFUSED: ClassVar[Mapping[str, str]] = {}
    """The sentences that refuse keys of other documents, by these keys."""
    MISSING: ClassVar[Mapping[str, str]] = {}
    """The sentences for keys that are required and absent."""
    __pydantic_config__: ClassVar[Mapping[str, Any]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        names = cls.JSON_NAMES
        cls.__pydantic_config__ = {
            "extra": "forbid",
            "strict": True,
            "allow_inf_nan": False,
            "alias_generator": lambda name: names.get(name, name),
        }

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """The members of a JSON object with those that follow from others."""
        return given

    def to_json(self) -> dict[str, Any]:
        """The document as plain Python data, ready for JSON; sequences and arrays are lists."""
        return {key_of(type(self), one.name): _plain(getattr(self, one.name)) for one in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        schema = {**handler(source), "strict": False}  # a dictionary will do; its values are read strictly
        docs = docs_of(cls)
        for one in schema["schema"]["fields"]:
            updates = {"description": docs[one["name"]]} if one["name"] in docs else {}
            one["metadata"] = {**one.get("metadata", {}), "pydantic_js_updates": updates}
            if one["schema"]["type"] == "default":
                if one["name"] in cls.NEEDED:
                    one["schema"] = one["schema"]["schema"]
                elif isinstance(one["schema"].get("default"), tuple):  # in JSON a list
                    one["schema"] |= {"default": [*one["schema"]["default"]], "copy_default": True}

        def read(value: Any, inner: Callable[[Any], Any], info: Any) -> Any:
            reader = getattr(info.context, "read", None)  # who counts faults
            value = cls.completed(value) if isinstance(value, Mapping) else value
            return inner(value) if reader is None else reader(cls, value, inner)

        ref = schema.pop("ref")  # another field of this type refers to the whole
        return {
            "type": "function-wrap",
            "function": {"type": "with-info", "function": read},
            "schema": schema,
            "ref": ref,
        }


def without_usual(document: Document) -> dict[str, Any]:
    """The JSON of a document without the keys that are left out where they have their default."""
    cls = type(document)
    usual = {
        key_of(cls, one.name)
        for one in fields(cls)  # type: ignore[arg-type]
        if LATER in getattr(types_of(cls)[one.name], "__metadata__", ()) and getattr(document, one.name) == one.default
    }
    return {key: value for key, value in document.to_json().items() if key not in usual}


def _plain(value: Any) -> Any:
    if isinstance(value, Document):
        return value.to_json()
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, str | PurePath):
        return str(value)
    if hasattr(value, "tolist"):  # an array
        return value.tolist()
    return [_plain(one) for one in value] if isinstance(value, Sequence) else value


def key_of(document: type[Document], name: str) -> str:
    """The key of a field."""
    return document.JSON_NAMES.get(name, name)


def keys_of(document: type[Any]) -> tuple[str, ...]:
    """The keys of a document."""
    return tuple(key_of(document, one.name) for one in fields(document))


def required_of(document: type[Any]) -> tuple[str, ...]:
    """The names of the fields that a document has to have."""
    return tuple(
        one.name
        for one in fields(document)
        if one.name in document.NEEDED or (one.default is MISSING and one.default_factory is MISSING)
    )


def _types_of(document: type[Any]) -> Mapping[str, Any]:
    hints = get_type_hints(document, include_extras=True)
    return {one.name: hints[one.name] for one in fields(document)}


types_of: Callable[[type[Any]], Mapping[str, Any]] = lru_cache(_types_of)  # type: ignore[assignment]
"""The types of the fields of a document, by their names."""


def docs_of(document: type[Any]) -> dict[str, str]:
    """What the fields of a document are, by their names: their docstrings, or the descriptions of their types."""
    marks = {name: getattr(kind, "__metadata__", ()) for name, kind in types_of(document).items()}
    docs = {
        name: str(mark.json["description"])
        for name, all_marks in marks.items()
        for mark in all_marks
        if isinstance(mark, Limits) and "description" in mark.json
    }
    for cls in filter(is_dataclass, reversed(document.__mro__)):
        docs |= _docstrings(cls.__module__).get(cls.__name__, {})
    return {name: text for name, text in docs.items() if name in marks}


@lru_cache
def _docstrings(module: str) -> dict[str, dict[str, str]]:
    """The docstrings of the fields of all classes of a module."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    found: dict[str, dict[str, str]] = {}
    for cls in [node for node in tree.body if isinstance(node, ast.ClassDef)]:
        for line, after in pairwise(cls.body):
            if not (isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)):
                continue
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                found.setdefault(cls.name, {})[line.target.id] = " ".join(str(after.value.value).split())
    return found


class Limits:
    """What values of a field have to satisfy, as pydantic's schemas say it; ``json`` goes into the JSON schema."""

    def __init__(self, *, json: Mapping[str, Any] | None = None, **limits: Any) -> None:
        self.limits, self.json = limits, json or {}

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        return {**handler(source), **self.limits}

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        return {**handler(schema), **self.json}


def described(text: str) -> Limits:
    """The description of all fields of a type."""
    return Limits(json={"description": text})


class Shown(Limits):
    """How a page shows a setting: its title, its bounds, which the solver checks, and the titles of its words."""

    def __init__(self, title: str = "", *, words: Mapping[str, str] | None = None, **bounds: float) -> None:
        super().__init__(json={**({"title": title} if title else {}), **bounds})
        self.words = words or {}


LATER = Limits()
"""Marks a key that requests leave out where it has its default, for services that do not know it."""


class InJson:
    """Marks a field that has another type in JSON: in Python more is taken."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        schema: CoreSchema = handler.generate_schema(self.kind)
        return schema


class Either:
    """Marks a union of plain values: one sentence refuses what is none of them."""

    def __init__(self, words: str) -> None:
        self.words = words

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        error = {"custom_error_type": "either", "custom_error_message": f"this must be {self.words}"}
        return {"type": "custom-error", "schema": handler(source), **error}


class Words:
    """Marks a text that is one of some words; ``uses`` says when to take which, in a sentence for each."""

    def __init__(self, *words: str, **uses: str) -> None:
        self.uses = {**dict.fromkeys(words, ""), **uses}

    def __iter__(self) -> Iterator[str]:
        return iter(self.uses)

    def __repr__(self) -> str:
        return f"Words({', '.join(map(repr, self))})"

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return {"type": "literal", "expected": [*self]}


class UpToAFault:
    """Parameters are read up to the first that is no number: then there is one complaint about all of them."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        return before(_up_to_a_fault, handler(source))


def _up_to_a_fault(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    kept: dict[Any, Any] = {}
    for name, number in value.items():
        kept[name] = number
        is_number = isinstance(number, int | float) and not isinstance(number, bool) and abs(number) < math.inf
        if not is_number or len(kept) > MAX_PARAMETERS:
            break
    return kept


def before(function: Callable[..., Any], schema: CoreSchema) -> CoreSchema:
    """The schema that reads what ``function`` returns of the value."""
    return {"type": "function-before", "function": {"type": "no-info", "function": function}, "schema": schema}


Numbers = Annotated[list[float], Limits(fail_fast=True)]
"""Read up to the first that is none."""
Pair = Annotated[Sequence[float], InJson(list[float]), Limits(min_length=2, max_length=2)]
Parameters = Annotated[dict[str, float], Limits(max_length=MAX_PARAMETERS), UpToAFault()]


@dataclass(frozen=True, eq=False, repr=False)
class OneOf:
    """Marks a field that holds one of several documents: the ``tag`` of a value is the name of its document."""

    documents: Mapping[str, type[Any]]
    tag: Callable[[Any], object]
    fault: str = ""
    """The type of the error of a value that is none of them."""
    sentence: str = ""
    default: str | None = None
    """The kind of a document that names none."""

    def __repr__(self) -> str:
        return f"OneOf({', '.join(map(repr, self.documents))})"

    def branch(self, value: Any) -> str | None:
        """The name of the document in the place of an error."""
        tag = self.tag(value)
        return TAG + tag if isinstance(tag, str) and tag in self.documents else None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        choices = {TAG + name: handler.generate_schema(document) for name, document in self.documents.items()}
        error = {"custom_error_type": self.fault, "custom_error_message": self.sentence} if self.fault else {}
        return {"type": "tagged-union", "discriminator": self.branch, "choices": choices, **error}


def by_key(*documents: type[Document]) -> OneOf:
    """A union whose document is the one that has the key that is present, its only one."""
    keys = {keys_of(document)[0]: document for document in documents}

    def tag(value: Any) -> str | None:
        has = value.__contains__ if isinstance(value, Mapping) else lambda key: hasattr(value, key)
        return next(filter(has, keys), None)

    text = 'a text, such as "tanh(20*x)", or ' if "expression" in keys else ""
    return OneOf(keys, tag, "source", f"this must be {text}an object with one of the keys {', '.join(keys)}")


def by_kind(*documents: type[Document], default: str | None = None) -> OneOf:
    """A union whose document is named by the key ``kind``."""
    kinds = {kind_of(document): document for document in documents}

    def tag(value: Any) -> object:
        return value.get("kind", default) if isinstance(value, Mapping) else getattr(value, "kind", None)

    return OneOf(kinds, tag, "kind", f"an object whose kind is one of {', '.join(kinds)}", default)


def kind_of(document: type[Any]) -> str:
    """The kind of a document."""
    return str(next(one.default for one in fields(document) if one.name == "kind"))


def one_of(annotation: Any) -> OneOf | None:
    """The documents of a field of this type, where it marks them: alone, or null, or in a list."""
    marks = getattr(annotation, "__metadata__", ())
    inner = get_args(annotation)[:1] if get_origin(annotation) is Annotated else get_args(annotation)
    return next((mark for mark in marks if isinstance(mark, OneOf)), None) or next(
        filter(None, map(one_of, inner)), None
    )
