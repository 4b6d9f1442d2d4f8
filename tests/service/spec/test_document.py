"""Strict JSON: what is read, and the place of what is refused."""

from __future__ import annotations

import math

import pytest

from equimesh_service.problems.problem import Problem
from equimesh_service.spec.document import escape_token, parse, sent_pointer


def test_json_is_read_with_its_numbers() -> None:
    assert parse(b'\xef\xbb\xbf{"a": [1, 2.5, null, "\\u00e4\\ud83d\\ude00"]}') == {"a": [1, 2.5, None, "ä\U0001f600"]}
    assert parse(b"-" + b"9" * 401) == -math.inf
    assert parse(b"9" * 400) == 10**400 - 1


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b'{"a": "\xff"}', "not UTF-8: bad byte at offset 7"),
        (b'{"a":\n 1,}', "line 2, column"),
        (b'{"a": {"b": 1, "b": 2}}', "The key 'b' comes twice"),
        (b"[" * 200_000, "nested too deeply"),
    ],
)
def test_what_is_no_strict_json_is_malformed(data: bytes, words: str) -> None:
    with pytest.raises(Problem) as caught:
        parse(data)
    assert caught.value.name == "malformed-body"
    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("data", "pointer"), [(b'{"a/b": ["x", "\\uD800"]}', "/a~1b/1"), (b'{"a": {"\\udfff": 1}}', "/a")]
)
def test_half_a_character_is_refused_where_it_stands(data: bytes, pointer: str) -> None:
    with pytest.raises(Problem) as caught:
        parse(data)
    assert [complaint.pointer for complaint in caught.value.errors] == [pointer]


def test_parts_of_pointers_are_escaped() -> None:
    assert (escape_token("a/b~c"), escape_token(3), escape_token("\ud800")) == ("/a~1b~0c", "/3", "/\\ud800")


@pytest.mark.parametrize(
    ("pointer", "sent"),
    [
        ("/monitor/u/expression", "/monitor/u"),
        ("/monitor/rho/expression", "/monitor/rho/expression"),
        ("/monitor/monitors/1/u/expression", "/monitor/monitors/1/u"),
        ("/monitor/u/expression/more", "/monitor/u"),
        ("/mode/x", "/mode/x"),
        ("/absent/0/key", "/absent/0/key"),
        ("", ""),
    ],
)
def test_a_pointer_ends_where_a_text_was_sent_for_an_expression(pointer: str, sent: str) -> None:
    members = [{"u": {"expression": "x"}}, {"u": "x"}]
    document = {"monitor": {"u": "x", "rho": {"expression": "x"}, "monitors": members}, "mode": "tight"}
    assert sent_pointer(document, pointer) == sent
