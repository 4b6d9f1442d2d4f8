"""The strict reading of documents."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest

from equimesh import InputError
from equimesh.specs.document import Reading, flag, mapping, number, several, text, whole
from equimesh_schema.document import Document, Either, Words, by_key, by_kind


@dataclass(frozen=True, kw_only=True)
class Pair(Document):
    JSON_NAMES: ClassVar = {"b": "other"}
    REFUSED: ClassVar = {"z": "this belongs to a triple"}
    kind: str = "pair"
    a: float
    b: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Empty(Document):
    kind: str = "empty"


@dataclass(frozen=True, kw_only=True)
class Word(Document):
    word: Annotated[str, Words("x", "y")] = "x"


@dataclass(frozen=True, kw_only=True)
class Plain(Document):
    size: Annotated[float | Literal["auto"] | None, Either("a number, auto or null")] = None
    count: int | Literal["auto"] = "auto"
    whole: int | None = None
    is_on: bool = False
    pair: Pair | None = None
    pairs: list[Annotated[Any, by_kind(Pair, Empty)]] = field(default_factory=list)
    given: object = None


def make(*, a: float, b: float = 2.0) -> tuple[float, float]:
    if a < 0:
        raise InputError("a is negative", field="a")
    if b < 0:
        raise InputError("b is negative", field="b")
    return a, b


READING = Reading({Pair: make, Empty: lambda: (), Word: lambda word: word, Plain: dict})
KINDS, KEYS = by_kind(Pair, Empty, default="pair"), by_key(Word)


def read_pair(given: object, path: str = "") -> Any:
    return READING.record(Pair, given, path)


def read_kinds(given: object, path: str = "") -> Any:
    return READING.one_of(KINDS, given, path)


def read_keys(given: object, path: str = "") -> Any:
    return READING.one_of(KEYS, given, path)


def read_plain(given: object, path: str = "") -> Any:
    return READING.record(Plain, given, path)


def test_what_is_absent_has_the_default_of_what_is_made() -> None:
    assert read_pair({"a": 1}) == read_kinds({"a": 1}) == (1.0, 2.0)
    assert read_kinds({"kind": "empty"}) == ()
    assert read_keys({"word": "x"}) == "x"


@pytest.mark.parametrize(
    ("read", "given", "field", "words"),
    [
        (read_pair, [], "at.pair", "a list: an object"),
        (read_pair, {}, "at.pair.a", "needs the key 'a'"),
        (read_pair, {"a": 1, "c": 1}, "at.pair.c", "known are 'a', 'other'"),
        (read_pair, {"a": 1, "othr": 1}, "at.pair.othr", "did you mean 'other'?"),
        (read_pair, {"a": 1, "z": 1}, "at.pair.z", "belongs to a triple"),
        (read_pair, {"a": 1, 3: 1}, "at.pair.3", "no key 3"),
        (read_pair, {"a": "1"}, "at.pair.a", "the text '1': a number"),
        (read_pair, {"a": -1}, "at.pair.a", "negative"),
        (read_pair, {"a": 1, "other": -1}, "at.pair.other", "negative"),
        (read_kinds, {"kind": "pairs"}, "at.pair.kind", "did you mean 'pair'?"),
        (read_kinds, {"kind": []}, "at.pair.kind", "'pair', 'empty'"),
        (read_kinds, {"kind": "empty", "a": 1}, "at.pair.a", "no key 'a'"),
        (read_keys, {"b": 1}, "at.pair", "one of the keys 'word'"),
        (read_keys, 3, "at.pair", "one of the keys"),
        (read_keys, {"a": 1, "word": "x"}, "at.pair.a", "no key 'a'"),
        (read_plain, {"size": "all"}, "at.pair.size", "a number is needed"),
        (read_plain, {"whole": 1.5}, "at.pair.whole", "a whole number is needed"),
        (read_plain, {"is_on": 1}, "at.pair.is_on", "true or false"),
        (read_plain, {"pair": {"a": True}}, "at.pair.pair.a", "a number is needed"),
        (read_plain, {"pairs": [{"kind": "empty"}, {"a": 1}]}, "at.pair.pairs.1.kind", "is missing"),
    ],
)
def test_a_fault_is_refused_with_its_path(read: Any, given: object, field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(given, "at.pair")
    assert caught.value.field == field
    assert words in caught.value.message


def test_values_of_unions_and_lists() -> None:
    for size, count in ((None, "auto"), ("auto", 3), (2, [])):
        assert read_plain({"size": size, "count": count}) == {"size": size, "count": count}
    made = read_plain({"pair": {"a": 3}, "pairs": [{"kind": "empty"}], "whole": None, "given": [1]})
    assert made == {"pair": (3.0, 2.0), "pairs": ((),), "whole": None, "given": [1]}


def test_another_reader_takes_the_place_of_a_union() -> None:
    reading = Reading({Plain: dict}, {types: lambda value, path: f"{path}={value}" for types in (KINDS,)})
    assert reading.value(Annotated[Any, KINDS], 3, "at") == "at=3"


@pytest.mark.parametrize(
    ("read", "good", "bad"),
    [
        (number, [1, 1.5, np.float32(2)], [True, "1", None, float("nan"), float("inf"), 10**400]),
        (whole, [1, np.int64(3)], [1.0, True, "1"]),
        (flag, [True, False], [0, "yes", None]),
        (text, ["", "x"], [1, None, b"x"]),
        (mapping, [{}], [[], "x", None]),
        (lambda value, path: several(number, value, path), [(1.0, 2.0), ()], ["12", 3, [1, "2"]]),
    ],
)
def test_a_reader_takes_its_type_only(read: Any, good: list[Any], bad: list[Any]) -> None:
    assert [read(value, "at") for value in good] == good
    for value in bad:
        with pytest.raises(InputError) as caught:
            read(value, "at")
        assert caught.value.field.startswith("at"), value
