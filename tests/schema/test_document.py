"""Documents as dataclasses, validated by pydantic without importing it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import pytest
from pydantic import TypeAdapter, ValidationError

from equimesh_schema.document import Document, Limits, by_kind, described, docs_of, keys_of, required_of, types_of

NUMBER = Annotated[float, described("A number.")]


@dataclass(frozen=True, kw_only=True)
class Leaf(Document):
    """A leaf."""

    kind: str = "leaf"
    size: NUMBER = 1.0
    of_python: int | None = None
    """Named otherwise."""

    JSON_NAMES: ClassVar = {"of_python": "of-json"}
    NEEDED: ClassVar = ("size",)


@dataclass(frozen=True, kw_only=True)
class Stone(Document):
    """A stone."""

    kind: str = "stone"


THINGS = by_kind(Leaf, Stone, default="leaf")


@dataclass(frozen=True, kw_only=True)
class Tree(Document):
    """A tree."""

    first: Annotated[Any, THINGS]
    others: Annotated[list[Annotated[Any, THINGS]], Limits(max_length=2)] = field(default_factory=list)


TREES = TypeAdapter(Tree)


def faults(document: object, context: object = None) -> list[tuple[str, str]]:
    with pytest.raises(ValidationError) as caught:
        TREES.validate_python(document, context=context)
    return [
        (".".join(str(part) for part in one["loc"] if not str(part).startswith("\x00")), one["type"])
        for one in caught.value.errors()
    ]


def test_a_document_is_read() -> None:
    tree = TREES.validate_python({"first": {"size": 2, "of-json": 3}, "others": [{"kind": "stone"}]})
    assert tree == Tree(first=Leaf(size=2.0, of_python=3), others=[Stone()])
    assert TREES.dump_python(tree, by_alias=True) == {
        "first": {"kind": "leaf", "size": 2.0, "of-json": 3},
        "others": [{"kind": "stone"}],
    }


@pytest.mark.parametrize(
    ("document", "place", "fault"),
    [
        ({}, "first", "missing"),
        ({"first": {}}, "first.size", "missing"),
        ({"first": {"size": "2"}}, "first.size", "float_type"),
        ({"first": {"size": float("inf")}}, "first.size", "finite_number"),
        ({"first": {"size": 1, "of_python": 3}}, "first.of_python", "unexpected_keyword_argument"),
        ({"first": {"kind": "cloud"}}, "first", "kind"),
        ({"first": {"kind": "stone"}, "others": [{"kind": "stone"}] * 3}, "others", "too_long"),
        ({"first": {"kind": "stone"}, "others": ({"kind": "stone"},)}, "others", "list_type"),
        (3, "", "dataclass_type"),
    ],
)
def test_a_fault_has_its_place(document: object, place: str, fault: str) -> None:
    assert faults(document) == [(place, fault)]


def test_who_reads_may_look_at_every_object() -> None:
    """Those of a type that occurs twice, too."""
    seen: list[str] = []

    class Reader:
        def read(self, document: type[Any], value: Any, inner: Any) -> Any:
            seen.append(document.__name__)
            return inner(value)

    TREES.validate_python({"first": {"size": 1}, "others": [{"size": 1}, {"kind": "stone"}]}, context=Reader())
    assert seen == ["Tree", "Leaf", "Leaf", "Stone"]


def test_a_document_says_what_its_keys_are() -> None:
    assert keys_of(Leaf) == ("kind", "size", "of-json")
    assert required_of(Leaf) == ("size",)
    assert docs_of(Leaf) == {"size": "A number.", "of_python": "Named otherwise."}
    assert types_of(Leaf)["size"] == NUMBER
    schema = TREES.json_schema()
    assert schema["$defs"]["Leaf"]["required"] == ["size"]
    assert schema["$defs"]["Leaf"]["properties"]["of-json"]["description"] == "Named otherwise."
    assert schema["properties"]["first"]["oneOf"] == [{"$ref": "#/$defs/Leaf"}, {"$ref": "#/$defs/Stone"}]
    assert schema["properties"]["others"]["maxItems"] == 2
