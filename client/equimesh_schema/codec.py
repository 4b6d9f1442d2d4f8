"""Answers as JSON and back: one codec for all dataclasses of this package."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Self, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

Json: TypeAlias = dict[str, Any]
T = TypeVar("T")


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
            "use_attribute_docstrings": True,
            "alias_generator": lambda name: names.get(name, name),
        }

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


def _types(cls: type[Any]) -> dict[str, Any]:
    """The types of the fields of a dataclass."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


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
    if isinstance(value, Mapping):
        return {name: _write(member) for name, member in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_write(member) for member in value]
    return str(value) if isinstance(value, str) else value


def real_or_nan(value: Any) -> float:
    """The value as a float. NaN where it is absent or not a number."""
    return float(value) if isinstance(value, int | float) else math.nan
