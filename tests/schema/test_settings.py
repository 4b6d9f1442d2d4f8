"""The settings of documents, as a command line and a page offer them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from equimesh_schema.document import Document, Either, Pair, Shown, Words
from equimesh_schema.monitors import MEMBERS, LeastError, Weight
from equimesh_schema.settings import choices, setting_of, settings_of
from equimesh_schema.sources import Function


@dataclass(frozen=True, kw_only=True)
class Thing(Document):
    kind: Literal["thing"] = "thing"
    u: Function = None
    size: Annotated[float, Shown("Its size", minimum=0.0)] = 2.0
    """How large it is."""
    count: Annotated[int | Literal["auto"], Either("a number, or 'auto'")] = "auto"
    word: Annotated[str, Words("first_one", "other")] = "other"
    bound: float | None = None
    is_on: bool = True
    ends: Pair = (0.0, 1.0)
    inner: Document | None = None
    names: list[str] = field(default_factory=list)


def test_a_setting_is_a_number_a_flag_or_a_word() -> None:
    found = {one.key: one for one in settings_of(Thing)}
    assert list(found) == ["size", "count", "word", "bound", "is_on"]
    assert [one.plain for one in found.values()] == [float, int, None, float, bool]
    assert [one.takes_null for one in found.values()] == [False, False, False, True, False]
    assert found["count"].words == ("auto",)
    assert setting_of(Thing, "u") is setting_of(Thing, "ends") is setting_of(Thing, "inner") is None


def test_a_setting_as_it_is_published() -> None:
    size, _, word, bound, _ = (one.to_json() for one in settings_of(Thing))
    assert size == {
        "name": "size",
        "type": "number",
        "default": 2.0,
        "help": "How large it is.",
        "words": [],
        "title": "Its size",
        "minimum": 0.0,
    }
    assert word["words"] == [{"name": "first_one", "title": "first one"}, {"name": "other", "title": "other"}]
    assert (bound["title"], bound["words"]) == ("Bound", [{"name": None, "title": "none"}])


def test_all_kinds_are_published_with_their_settings() -> None:
    found: Any = json.loads(json.dumps(choices()))
    kinds = {one["name"]: one for one in found["monitors"]}
    assert kinds["weight"]["functions"] == ["rho", "u"]
    assert [kind for kind, one in kinds.items() if one["member"]] == [*MEMBERS.documents]
    for document in (LeastError, Weight):
        shown = [one["name"] for one in kinds[document.kind]["settings"]]
        assert shown == [one.key for one in settings_of(document)]
    assert {one["name"] for one in found["transmissions"]} >= {"optimized", "classical"}
