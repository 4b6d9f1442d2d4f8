"""Dictionaries of OpenFOAM: entries, lists, variables; and what is refused, by its line."""

from __future__ import annotations

import tracemalloc

import pytest

from equimesh.errors import InputError
from equimesh.io.reading.foam import Entries, Items, Word, list_of, numbers_of, one_word, parse, text_of

TEXT = """// a comment
scale 0.5; /* two
lines */
pair (1 2);
list ( a $pair (3 4) "a b" );
inner { x 1; deep { y 2; } }
empty ( );
"""


def test_entries_lists_and_variables() -> None:
    found = parse(TEXT)
    assert one_word(found.values["scale"], "scale").number() == 0.5
    items = list_of(found, "list")
    assert [text_of(item) for item in items] == ["a", "( )", "( )", '"a b"']
    assert numbers_of(items[1], 2) == [1, 2]
    (inner,) = found.values["inner"]
    assert isinstance(inner, Entries)
    (deep,) = inner.values["deep"]
    assert isinstance(deep, Entries)
    assert deep.values["y"] == [Word("2", 6)]
    assert list_of(found, "empty") == []
    assert list_of(found, "none", needed=False) == []


def test_a_file_that_is_one_list() -> None:
    loose = parse("FoamFile { version 2.0; }\n1\n(\n wall { nFaces 3; }\n)\n").loose
    assert isinstance(loose[-1], Items)
    assert text_of(loose[-1].items[0]) == "wall"


REFUSED = {
    "line 2: '#calc' needs OpenFOAM": 'a 1;\nb #calc "1 + 2";',
    "line 1: '#include' needs OpenFOAM": '#include "other"',
    "line 3: the variable '$c' is no entry above it": "a 1;\nb 2;\nd $c;",
    "the variable '$:a.b'": "a { b 1; }\nc $:a.b;",
    "line 2: the file ends inside an entry": "a { b 1;\n",
    "line 1: this '(' is not closed": "a ( 1 2",
    "line 1: ')' is not expected here": "a 1 );",
    "line 2: the entry 'b' does not end with ';'": "a 1;\nb 2",
    "more than 32 lists inside each other": "a " + "(" * 40 + ")" * 40 + ";",
    "variables bring more than": "a0 (1);" + "".join(f"a{k + 1} (" + f"$a{k} " * 10 + ");" for k in range(8)),
}


@pytest.mark.parametrize("told", REFUSED)
def test_what_is_no_literal_dictionary_is_refused_by_its_line(told: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(REFUSED[told])
    assert told in caught.value.message


def test_wrong_kinds_of_items_are_named() -> None:
    found = parse("a (1 2);\nb x;\nc (1 (2));")
    with pytest.raises(InputError, match="line 2: 'x' is no number"):
        one_word(found.values["b"], "b").number()
    with pytest.raises(InputError, match="line 1: a needs one value"):
        one_word(found.values["a"], "a")
    with pytest.raises(InputError, match="line 3: one word or number is expected"):
        numbers_of(found.values["c"][0], 2)
    with pytest.raises(InputError, match="line 1: 3 numbers"):
        numbers_of(found.values["a"][0], 3)
    with pytest.raises(InputError, match=r"line 2: the blockMeshDict needs a list b"):
        list_of(found, "b")


@pytest.mark.parametrize("bad", ["/* ", '"\\'])
def test_comments_and_texts_that_never_end_are_searched_once(bad: str) -> None:
    with pytest.raises(InputError):
        parse("a " + bad * 200_000)


def test_a_text_that_does_not_end_takes_little_memory() -> None:
    text = '("' + "\\" * (1 << 20)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="is not closed"):
            parse(text)
        assert tracemalloc.get_traced_memory()[1] < 20 * len(text)
    finally:
        tracemalloc.stop()
