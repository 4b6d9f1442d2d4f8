"""The sentences for values that do not fit: one for each fault that models and parameters of requests can have."""

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from equimesh_schema.mesh import WITHOUT_NUL

# The most characters of an unknown word that is compared with the known ones.
_MAX_COMPARED = 40
# How similar the nearest word has to be, from 0 to 1.
_MIN_SIMILARITY = 0.6


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """The end of a sentence about an unknown word: the known word that is nearest to it, "" where none is near."""
    if not isinstance(given, str):
        return ""
    by_lower = {word.lower(): word for word in known}
    near = get_close_matches(given[:_MAX_COMPARED].lower(), by_lower, n=1, cutoff=_MIN_SIMILARITY)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def sentence_of(entry: Mapping[str, Any]) -> str | None:
    """The sentence for an entry of pydantic's errors; None for a type that has no sentence here."""
    make = _SENTENCES.get(entry["type"])
    return make(entry) if callable(make) else make


def _length_of_text(entry: Mapping[str, Any]) -> str:
    return f"this text may have at most {entry['ctx']['max_length']} characters"


def _too_many(entry: Mapping[str, Any]) -> str:
    most = entry["ctx"]["max_length"]
    if entry["ctx"]["field_type"] != "List":
        return f"this object may have at most {most} keys"
    return "this must be a list of 2 items" if most == 2 else f"this must be a list of at most {most} items"


def _choice(entry: Mapping[str, Any]) -> str:
    expected = str(entry["ctx"]["expected"])
    return f"this must be {expected}{did_you_mean(entry['input'], expected.split(chr(39))[1::2])}"


def _pattern(entry: Mapping[str, Any]) -> str:
    if entry["ctx"]["pattern"] == WITHOUT_NUL:
        return "this text must not hold the character U+0000"
    return f"this text must have the form {entry['ctx']['pattern']}"


def _at_least(entry: Mapping[str, Any]) -> str:
    return f"this must be at least {entry['ctx']['ge']}"


def _more_than(entry: Mapping[str, Any]) -> str:
    return f"this must be more than {entry['ctx']['gt']:g}"


def _at_most(entry: Mapping[str, Any]) -> str:
    return f"this must be at most {entry['ctx']['le']}"


_OBJECT = "this must be a JSON object"
_NUMBER = "this must be a number"
_WHOLE_NUMBER = "this must be a whole number"
_SWITCH = "this must be true or false"
_SENTENCES: Mapping[str, str | Callable[[Mapping[str, Any]], str]] = {
    "model_type": _OBJECT,
    "dataclass_type": _OBJECT,
    "dict_type": _OBJECT,
    "list_type": "this must be a list",
    "string_type": "this must be a text",
    "string_unicode": "this text holds half of a surrogate pair; send whole characters",
    "string_too_long": _length_of_text,
    "string_pattern_mismatch": _pattern,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": "this whole number has too many digits",
    "int_from_float": _WHOLE_NUMBER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": "this must be a finite number, not NaN or infinity",
    "bool_type": _SWITCH,
    "bool_parsing": _SWITCH,
    "literal_error": _choice,
    "too_short": "this must be a list of 2 items",
    "too_long": _too_many,
    "greater_than": _more_than,
    "greater_than_equal": _at_least,
    "less_than_equal": _at_most,
    "missing": "this is required",
}
