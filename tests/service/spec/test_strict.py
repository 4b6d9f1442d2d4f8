"""Bad JSON of a spec: wrong types, unknown keys, texts that no database takes."""

from __future__ import annotations

import httpx
import pytest

from service.conftest import small
from service.spec.bad_specs import (
    Refusal,
    expect_refusal,
)

DOCUMENTS: dict[str, Refusal] = {
    "no object": (small(grid=[8, 8]), "/grid", "must be a JSON object", None),
    "half a character": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "label": "\\ud800"}',
        "/label",
        "surrogate",
        None,
    ),
    "a text that no database takes": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "label": "a\\u0000b"}',
        "/label",
        "this text must not hold the character U+0000",
        None,
    ),
    "half a key": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "\\udfff": 1}',
        "",
        "surrogate",
        None,
    ),
    "unknown key": (small(labell="x"), "/labell", "known are", None),
    "unknown inner key": (small(grid={"n_x": 8}), "/grid/n_x", "n_xi, n_eta", None),
    "pointer escapes": (small(**{"a/b~c": 1}), "/a~1b~0c", "no such key", None),
    "a list": ([], "", "object", None),
    "a number": ("3", "", "object", None),
    "null": ("null", "", "object", None),
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, DOCUMENTS[name])
