"""Documents of requests, read strictly."""

from __future__ import annotations

import json
import math
import re
import tracemalloc

import httpx
import pytest
from pydantic import TypeAdapter, ValidationError

from equimesh_schema.mesh import MeshSpec
from equimesh_service.problems.problem import Problem
from equimesh_service.spec import document
from equimesh_service.spec.document import check_bounds, escape_token, parse, sent_pointer
from equimesh_service.spec.strict import MAX_COMPLAINTS, Faults, validate
from service.conftest import small


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


# The bounds of a JSON text: each one is kept at its value, and refused beyond it, before anything is built.


DEEP = document.MAX_DEPTH
LONG = document.MAX_TEXT_BYTES
DIGITS = document.MAX_DIGITS
WINDOW = document._WINDOW_BYTES
BLANKS = b" " * 600  # long enough to be read with arrays
ACROSS = b" " * (WINDOW - DIGITS // 2)  # a number then begins before the end of a window, and ends after it


def keys(number: int) -> bytes:
    return b"{" + b",".join(b'"%d":1' % key for key in range(number)) + b"}"


def texts(number: int, size: int = 1) -> bytes:
    return b"[" + b",".join([b'"' + b"a" * size + b'"'] * number) + b"]"


KEPT: dict[str, bytes] = {
    "depth": b"[" * DEEP + b"]" * DEEP,
    "depth, with arrays": b"[" * DEEP + BLANKS + b"]" * DEEP,
    "lists one after the other": b"[" + b"[],{}," * 300 + b"1]",
    "keys": keys(document.MAX_KEYS),
    "texts": texts(document.MAX_TEXTS),
    "a long text": texts(1, LONG),
    "a text of escapes": b'["' + b'\\"' * (LONG // 2) + b'"]',
    "digits": b"[" + b"1" * DIGITS + b"]",
    "digits across windows": ACROSS + b"1" * DIGITS,
    "numbers next to a text": b"1" * DIGITS + b'"a"' + b"1" * DIGITS,
    "brackets in a text": b'["' + b"[" * 1000 + b'", "\\\\", "\\"' + b"{" * 1000 + b'"]',
    "values": b"[" + b"1," * 997 + b"1]",
    "no end of a text": b'["aaa',
    "no JSON": b"}}]]" * 1000,
}
BROKEN: dict[str, tuple[bytes, str]] = {
    "depth": (b"[" * (DEEP + 1), "nested too deeply"),
    "depth, with arrays": (b"[" * DEEP + BLANKS + b"{", "nested too deeply"),
    "depth after texts": (b'{"a":' * (DEEP + 1), "nested too deeply"),
    "keys": (keys(document.MAX_KEYS + 1), "more than 8192 keys"),
    "texts": (texts(document.MAX_TEXTS + 1), "more than 20000 texts"),
    "a long text": (texts(1, LONG + 1), "A text has more than"),
    "a text that does not end": (b'"' + b"\\" * 2 * LONG, "A text has more than"),
    "a text of escapes": (b'["' + b'\\"' * (LONG // 2) + b'a"]', "A text has more than"),
    "all texts": (texts(document.MAX_TEXTS_BYTES // LONG + 1, LONG), "The texts of the body"),
    "digits": (b"1" * (DIGITS + 1), "more than 10000 digits"),
    "digits across windows": (ACROSS + b"1" * (DIGITS + 1), "more than 10000 digits"),
    "digits over whole windows": (b"1" * 3 * WINDOW, "more than 10000 digits"),
    "values": (b"[" + b"1," * 998 + b"1]", "more than 999 values"),
    "values in windows": (b"[" + b"1," * WINDOW + b"1]", "more than 999 values"),
}


@pytest.mark.parametrize("name", KEPT)
def test_what_keeps_the_bounds_passes(name: str) -> None:
    most = {"values": 999, "texts": 30_000, "keys": 9000}.get(name, 5000)
    check_bounds(KEPT[name], most)


@pytest.mark.parametrize("name", BROKEN)
def test_one_more_is_refused(name: str) -> None:
    data, words = BROKEN[name]
    with pytest.raises(Problem) as caught:
        check_bounds(data, 999 if "values" in name else 10**6)
    assert words in caught.value.detail
    assert caught.value.kind.status == (413 if "values" in name else 400)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (keys(document.MAX_KEYS_OF_OBJECT + 1), "An object has 129 keys"),
        (b'{"' + b"a" * (document.MAX_NAME + 1) + b'": 1}', "A key has more than 256 characters"),
    ],
)
def test_one_object_has_few_and_short_keys(data: bytes, words: str) -> None:
    with pytest.raises(Problem, match=words):
        parse(data)
    assert len(parse(keys(document.MAX_KEYS_OF_OBJECT))) == document.MAX_KEYS_OF_OBJECT


def test_an_object_of_lists_has_as_many_keys_as_blocks_have_vertices() -> None:
    vertices = {str(k): [k, 0] for k in range(document.MAX_LISTS_OF_OBJECT)}
    assert parse(json.dumps(vertices).encode()) == vertices
    with pytest.raises(Problem, match="An object has 1025 keys; at most 1024 are read"):
        parse(json.dumps({**vertices, "one": [0, 0]}).encode())
    with pytest.raises(Problem, match="at most 128 are read"):
        parse(json.dumps({**vertices, "0": 1}).encode())


def test_nothing_is_built_of_a_text_beyond_the_bounds() -> None:
    texts = [keys(300_000), b"[" * 3_000_000, b"[" + b"[]," * 1_000_000, b"[" + b"1," * 1_500_000, b"9" * 3_000_000]
    tracemalloc.start()
    try:
        for text in texts:
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            with pytest.raises(Problem):
                parse(text)
            # A window as arrays; a dict of these keys takes 30 MB.
            assert tracemalloc.get_traced_memory()[1] - before < 30 * WINDOW
    finally:
        tracemalloc.stop()


def test_an_unknown_word_gets_the_nearest_known_one(http: httpx.Client) -> None:
    for spec, pointer, near in (
        ({"monitr": {"u": "x"}}, "/monitr", "monitor"),
        (small(grid={"nxi": 9}), "/grid/nxi", "n_xi"),
        (small(monitor={"kind": "curvatur", "u": "x"}), "/monitor/kind", "curvature"),
        (small(monitor={"u": {"expresion": "x"}}), "/monitor/u", "expression"),
        (small(boundary="Trase"), "/boundary", "trace"),
        (small(monitor={"u": "tnah(x)"}), "/monitor/u", "tanh"),
    ):
        errors = {entry["pointer"]: entry["message"] for entry in http.post("/v1/meshes", json=spec).json()["errors"]}
        assert re.search(f"did you mean '?{near}'?", errors[pointer]), errors


def test_another_form_that_fits_is_named(http: httpx.Client) -> None:
    for spec, pointer, words in (
        (small(monitor={"u": 3}), "/monitor/u", 'a text, such as "tanh(20*x)", or an object with one of the keys'),
        (small(domain={"blocks": []}), "/domain/blocks", 'a rectangle has none: add "kind": "blocks"'),
    ):
        (error,) = http.post("/v1/meshes", json=spec).json()["errors"]
        assert (error["pointer"], words in error["message"]) == (pointer, True)


def test_few_faults_are_looked_for() -> None:
    wrong = {"expression": 3, "parameters": {f"p{k}": "a" for k in range(64)}, **{f"q{k}": 1 for k in range(60)}}
    tensor = {"kind": "tensor", "m11": wrong, "m12": wrong, "m22": wrong}
    document = {"monitor": {"kind": "intersection", "monitors": [tensor] * 8}, "grid": 3, "boundary": 1, "cells": 2}
    document |= {f"z{k}": 1 for k in range(100)}
    with pytest.raises(ValidationError) as every:
        TypeAdapter(MeshSpec).validate_python(document)
    assert every.value.error_count() > 1000
    with pytest.raises(ValidationError) as few:
        TypeAdapter(MeshSpec).validate_python(document, context=Faults())
    # Twenty, the fields of the objects that were open then, and one for each object that was not looked at.
    assert few.value.error_count() < 3 * MAX_COMPLAINTS
    with pytest.raises(Problem) as caught:
        validate(MeshSpec, document)
    assert len(caught.value.errors) == MAX_COMPLAINTS
