"""Entries of a description: objects, lists, names and numbers, with the path of a bad one."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import equimesh as em
from equimesh.blocks.curve_entries import entries, mapping, members, name_among, number, point, whole


def test_good_entries_come_back() -> None:
    assert members({"a": 1}, "domain", ("a", "b")) == {"a": 1}
    assert entries([1, 2], "domain.corners", count=2) == [1, 2]
    assert name_among("a", "domain.corners[0]", ("a",), "vertex") == "a"
    assert (number(2, "f"), whole(7, "f", 7), point((1, 2.5), "f")) == (2.0, 7, (1.0, 2.5))


@pytest.mark.parametrize(
    ("check", "field", "message"),
    [
        (
            lambda: members({"vertex": 1}, "domain", ("vertices",)),
            "domain.vertex",
            "'vertex' that is not known",
        ),
        (lambda: mapping([1], "domain.curves"), "domain.curves", "curves is a list: it must be an object"),
        (lambda: mapping({1: 2}, "domain.curves"), "domain.curves", "must be an object"),
        (lambda: entries("ab", "domain.blocks"), "domain.blocks", "blocks is the text 'ab': it must be a list"),
        (lambda: entries([1], "domain.corners", count=4), "domain.corners", "has 1 entries: it must have 4"),
        (lambda: name_among("z", "f", ("a", "b"), "vertex"), "f", "'z' is no vertex: there are a, b"),
        (lambda: name_among([], "f", (), "curve"), "f", "there are none"),
        (lambda: number(float("nan"), "f"), "f", "f is nan"),
        (lambda: number(True, "f"), "f", "a boolean"),
        (lambda: number(0, "f", positive=True), "f", "f is 0: it must be a positive number"),
        (lambda: whole(2.0, "f", 5), "f", "f is 2.0: it must be a whole number from 1 to 5"),
        (lambda: point([1, "x"], "f"), "f[1]", "the text 'x'"),
    ],
)
def test_bad_entries_are_refused_with_their_path(check: Callable[[], object], field: str, message: str) -> None:
    with pytest.raises(em.InputError) as caught:
        check()
    assert caught.value.field == field
    assert message in caught.value.message
