"""Headers in which a client requests media types (Accept) and a wait (Prefer, RFC 7240)."""

import re
from collections.abc import Mapping

from equimesh_service.problems.problem import Problem

# The most characters of a Prefer header.
MAX_PREFER = 200
_TOKEN = r"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_WORD = rf'({_TOKEN}|"[^"\\]*")'
_OTHER = rf"(?![Ww][Aa][Ii][Tt] *(=|;|,|$)){_TOKEN}( *= *{_WORD})?( *; *{_TOKEN}( *= *{_WORD})?)*"
_PREFERENCE = rf'([Ww][Aa][Ii][Tt] *= *("[0-9]{{1,9}}"|[0-9]{{1,9}})|{_OTHER})'
# The form of a Prefer header: preferences with commas between them; a wait has a whole number.
PREFER_PATTERN = rf"^{_PREFERENCE}( *, *{_PREFERENCE})*$"
_PREFER = re.compile(PREFER_PATTERN)
_EACH = re.compile(_PREFERENCE)
_WAIT = re.compile(r'wait *= *"?([0-9]+)"?', re.IGNORECASE)
_JSON = ("application/json", "application/problem+json")


def parse_accept(header: str) -> list[str]:
    """The media types of an Accept header, by falling quality; those with q=0 are left out."""
    found: list[tuple[float, str]] = []
    for entry in header.split(","):
        name, *parameters = (part.strip().lower() for part in entry.split(";"))
        quality = 1.0
        for parameter in parameters:
            if match := re.fullmatch(r"q\s*=\s*([01](?:\.\d{0,3})?)", parameter):
                quality = float(match.group(1))
        if name and quality > 0:
            found.append((-quality, name))
    return [name for _, name in sorted(found, key=lambda entry: entry[0])]


def choose_offer(header: str | None, offers: Mapping[str, str]) -> str | None:
    """The first choice of Accept among the offers, None for no match; without the header, the first offer.

    ``offers`` maps names to media types.
    """
    for wanted in parse_accept(header or "*/*"):
        group = wanted.removesuffix("*") if wanted.endswith("/*") else None
        for name, media_type in offers.items():
            if wanted in (media_type, "*/*", "*") or (group is not None and media_type.startswith(group)):
                return name
    return None


def choose_explicit_offer(header: str | None, offers: Mapping[str, str]) -> str | None:
    """The offer that Accept names before JSON and wildcards, None for no such offer."""
    for wanted in parse_accept(header or ""):
        if wanted in _JSON or "*" in wanted:
            return None
        for name, media_type in offers.items():
            if wanted == media_type:
                return name
    return None


def parse_wait(header: str | None) -> int | None:
    """The seconds of ``Prefer: wait=N``, None without them; raises a 400 problem for what is no Prefer header.

    Other preferences are allowed, and ignored, as RFC 7240 says.
    """
    if header is None:
        return None
    if len(header) > MAX_PREFER or not _PREFER.fullmatch(header):
        detail = f"Prefer: {header[:40]!r} cannot be read. Write wait=30, with a whole number of seconds."
        raise Problem("malformed-header", detail, remedy="Send Prefer: wait=30, or no Prefer.")
    found = (_WAIT.fullmatch(each[0]) for each in _EACH.finditer(header))
    return next((int(wait[1]) for wait in found if wait is not None), None)
