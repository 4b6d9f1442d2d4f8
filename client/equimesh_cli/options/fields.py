"""Options that are fields of the documents of a request: how they are spelled, read and described."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, Literal, get_args, get_origin

from equimesh_schema.document import Words, docs_of, one_of, types_of
from equimesh_schema.sources import SOURCES

FLAGS = {
    "purpose": "for",
    "data": "interface-data",
    "compare_single_domain": "compare",
    "norm of target": "target-norm",
    "error of target": "target-error",
}
"""The options of fields that have another name in Python."""
METAVARS = {"smoothing": "RADIUS", "orthogonality": "DEGREES", "line_correction": "N", "error": "ERROR"}


def dashed(word: str) -> str:
    """A word of a spec, such as a kind of monitor, as it is spelled here; ``least_error`` itself is understood, too."""
    return word.replace("_", "-")


def flag(name: str) -> str:
    """The option of a field."""
    return f"-{name}" if len(name) == 1 and name != "p" else f"--{FLAGS.get(name, dashed(name))}"


def add_field(
    group: argparse._ActionsContainer,
    document: type[Any],
    name: str,
    *,
    option: str = "",
    owners: str = "",
    spelled: Callable[[str], str] = str,
    has_default: bool = False,
) -> None:
    """Add the option of a field: its help is the docstring of the field, and its default.

    What is not given is None, or with ``has_default`` the default. ``owners`` are the kinds that have it, ``spelled``
    spells its words.
    """
    (field,) = (one for one in fields(document) if one.name == name)
    group.add_argument(
        option or flag(name),
        dest=(option or name).lstrip("-").replace("-", "_"),
        default=field.default if has_default else None,
        help=f"{owners}{docs_of(document).get(name, '')}{_shown(field.default)}".replace("%", "%%").replace(
            "null", "none"
        ),
        **_reading(field, types_of(document)[name], spelled),
    )


def _shown(default: object) -> str:
    return "" if default is MISSING or default is None or default is False else f" ({default})"


def _reading(field: Field[Any], annotation: Any, spelled: Callable[[str], str]) -> dict[str, Any]:
    """How an option is read that is a field of this type."""
    if one_of(annotation) is SOURCES:
        return {"metavar": field.name.upper().removesuffix("HO")}
    plain, words, marked = _parts_of(annotation)
    if bool in plain:
        return {"action": argparse.BooleanOptionalAction if field.default else "store_true"}
    if words and not plain:
        end = ("none",) if type(None) in marked and field.default is not None else ()
        return {"type": spelled, "choices": tuple(map(spelled, (*words, *end)))}
    if type(None) in marked and field.default is not None:
        words = (*words, "none")
    kind = float if float in plain else int
    metavar = {"metavar": METAVARS[field.name]} if field.name in METAVARS else {}
    return {"type": number_or(kind, words) if words else kind, **metavar}


def _parts_of(annotation: Any) -> tuple[set[Any], tuple[str, ...], set[Any]]:
    """The plain types of a type, its words, and all its parts."""
    parts, marks = [annotation], [*getattr(annotation, "__metadata__", ())]
    for one in parts:
        parts += [part for part in get_args(one) if get_origin(one) is not Literal]
        marks += getattr(one, "__metadata__", ())
    words = [word for one in parts if get_origin(one) is Literal for word in get_args(one)]
    listed = next((mark for mark in marks if isinstance(mark, Words)), None)
    plain = {one for one in parts if one in (bool, float, int)}
    return plain, tuple(listed or words), {one for one in parts if isinstance(one, type)}


def number_or(kind: type[float] | type[int], words: Iterable[str]) -> Callable[[str], float | str]:
    """The reader of a number of this kind, or of one of some words."""
    known = tuple(words)

    def read(text: str) -> float | str:
        if text.lower() in known:
            return text.lower()
        try:
            return kind(text)
        except ValueError:
            noun = "number" if kind is float else "whole number"
            raise argparse.ArgumentTypeError(f"{text!r} is neither a {noun} nor {' nor '.join(known)}") from None

    return read


def given_of(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """The options that are given, by the names of their fields; ``none`` is None."""
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    return {name: None if (name, value) == ("tolerance", "none") else value for name, value in given.items()}


def foreign_to(kind: str, given: Iterable[str], owners: Mapping[str, Iterable[str]], option: str) -> str:
    """The sentence about options that ``kind`` does not have, of those that are ``given``; empty where it has all.

    ``owners`` has the names of the fields of each kind; ``option`` chooses the kind.
    """
    every = {name for names in owners.values() for name in names}
    foreign = [name for name in sorted(given) if name in every and name not in owners[kind]]
    if not foreign:
        return ""
    others = " or ".join(other for other, names in owners.items() if foreign[0] in names)
    return f"{flag(foreign[0])} is for {option} {others}, and this is {option} {kind}"
