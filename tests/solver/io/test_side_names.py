"""Names of sides in formats that take words only."""

from __future__ import annotations

from equimesh.io.solver_files import quoted, words


def test_words_are_kept_and_others_made_to_words() -> None:
    assert words(["inlet", "the wall", "top.1"]) == {"inlet": "inlet", "the wall": "the_wall", "top.1": "top.1"}
    assert words(["", "ä{}"]) == {"": "side", "ä{}": "___"}


def test_words_differ() -> None:
    found = words(["a b", "a_b", "a;b", "a(b"])
    assert found == {"a b": "a_b_2", "a_b": "a_b", "a;b": "a_b_3", "a(b": "a_b_4"}
    assert words(["frontAndBack"], taken=["frontAndBack"]) == {"frontAndBack": "frontAndBack_2"}


def test_quotes_and_line_ends_leave_names_between_quotes() -> None:
    assert quoted(['the "big" wall', "a b\n"]) == {'the "big" wall': "the _big_ wall", "a b\n": "a b_"}
