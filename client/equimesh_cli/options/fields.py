"""Options that are fields of the documents of a request: how they are spelled, read and described."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from typing import Any

from equimesh_schema.document import docs_of
from equimesh_schema.settings import Setting, setting_of

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
    setting = setting_of(document, name)
    (default,) = (one.default for one in fields(document) if one.name == name)
    told = docs_of(document).get(name, "").replace("null", "none")
    group.add_argument(
        option or flag(name),
        dest=(option or name).lstrip("-").replace("-", "_"),
        default=default if has_default else None,
        help=f"{owners}{told}{_shown(default)}".replace("%", "%%"),
        **({"metavar": name.upper().removesuffix("HO")} if setting is None else _reading(name, setting, spelled)),
    )


def _shown(default: object) -> str:
    return "" if default is MISSING or default is None or default is False else f" ({default})"


def _reading(name: str, setting: Setting, spelled: Callable[[str], str]) -> dict[str, Any]:
    """How the option of a setting is read. None is the word ``none``, where it is not the default."""
    words = (*setting.words, "none") if setting.takes_null and setting.default is not None else setting.words
    if setting.plain is None:
        return {"type": spelled, "choices": tuple(map(spelled, words))}
    if setting.plain is bool:
        return {"action": argparse.BooleanOptionalAction if setting.default else "store_true"}
    metavar = {"metavar": METAVARS[name]} if name in METAVARS else {}
    return {"type": number_or(setting.plain, words) if words else setting.plain, **metavar}


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
