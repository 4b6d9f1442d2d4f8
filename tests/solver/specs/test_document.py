"""The strict reading of plain documents."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from equimesh import InputError
from equimesh.specs.document import ByKey, ByKind, Record, either, flag, mapping, number, optional, several, text, whole


def make(*, a: float, b: float = 2.0) -> tuple[float, float]:
    if a < 0:
        raise InputError("a is negative", field="a")
    if b < 0:
        raise InputError("b is negative", field="pair.b")
    return a, b


PAIR = Record(make, {"a": number, "b": number})
KINDS = ByKind({"pair": PAIR, "empty": Record(lambda: (), {})}, default="pair")
KEYS = ByKey({"a": PAIR, "word": Record(lambda word: word, {"word": text})})


def test_what_is_absent_has_the_default_of_what_is_made() -> None:
    assert PAIR({"a": 1}) == KINDS({"a": 1}) == KEYS({"a": 1}) == (1.0, 2.0)
    assert KINDS({"kind": "empty"}) == ()
    assert KEYS({"word": "x"}) == "x"


@pytest.mark.parametrize(
    ("read", "given", "field", "words"),
    [
        (PAIR, [], "at.pair", "a list: an object"),
        (PAIR, {}, "at.pair.a", "needs the key 'a'"),
        (PAIR, {"a": 1, "c": 1}, "at.pair.c", "known are 'a', 'b'"),
        (PAIR, {"a": 1, "bb": 1}, "at.pair.bb", "did you mean 'b'?"),
        (PAIR, {"a": 1, 3: 1}, "at.pair.3", "no key 3"),
        (PAIR, {"a": "1"}, "at.pair.a", "the text '1': a number"),
        (PAIR, {"a": -1}, "at.pair.a", "negative"),
        (PAIR, {"a": 1, "b": -1}, "at.pair.b", "negative"),
        (KINDS, {"kind": "pairs"}, "at.pair.kind", "did you mean 'pair'?"),
        (KINDS, {"kind": []}, "at.pair.kind", "'pair', 'empty'"),
        (KINDS, {"kind": "empty", "a": 1}, "at.pair.a", "no key 'a'"),
        (KEYS, {"b": 1}, "at.pair", "one of the keys 'a', 'word'"),
        (KEYS, 3, "at.pair", "one of the keys"),
        (KEYS, {"a": 1, "word": "x"}, "at.pair.word", "no key 'word'"),
    ],
)
def test_a_fault_is_refused_with_its_path(read: Any, given: object, field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(given, "at.pair")
    assert caught.value.field == field
    assert words in caught.value.message


@pytest.mark.parametrize(
    ("read", "good", "bad"),
    [
        (number, [1, 1.5, np.float32(2)], [True, "1", None, float("nan"), float("inf"), 10**400]),
        (whole, [1, np.int64(3)], [1.0, True, "1"]),
        (flag, [True, False], [0, "yes", None]),
        (text, ["", "x"], [1, None, b"x"]),
        (mapping, [{}], [[], "x", None]),
        (either("auto", number), ["auto", 1.0], ["Auto", None]),
        (optional(number), [None, 1.0], ["1"]),
        (several(number), [(1.0, 2.0), ()], ["12", 3, [1, "2"]]),
    ],
)
def test_a_reader_takes_its_type_only(read: Any, good: list[Any], bad: list[Any]) -> None:
    assert [read(value, "at") for value in good] == good
    for value in bad:
        with pytest.raises(InputError) as caught:
            read(value, "at")
        assert caught.value.field.startswith("at"), value


def test_items_of_a_list_have_their_number_in_the_path() -> None:
    with pytest.raises(InputError) as caught:
        several(PAIR)([{"a": 1}, {"a": "1"}], "list")
    assert caught.value.field == "list.1.a"
