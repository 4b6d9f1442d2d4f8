"""The variables of the environment that mean to be settings, and are none."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches

from equimesh_service.settings import Settings

PREFIX = "EQUIMESH_"
# What clients read: an address and an API key.
_OF_CLIENTS = ("URL", "KEY")


def variable(name: str) -> str:
    """The variable of a setting."""
    return PREFIX + name.upper()


def unknown(environment: Mapping[str, str]) -> dict[str, str | None]:
    """Every variable that begins as settings do and is none, with the setting's variable that it is nearest to."""
    known = [*map(str.upper, Settings.model_fields), *_OF_CLIENTS]
    found: dict[str, str | None] = {}
    for given in sorted(environment):
        name = given.upper()
        if name.startswith(PREFIX) and name.removeprefix(PREFIX) not in known:
            nearest = get_close_matches(name.removeprefix(PREFIX), known, n=1)
            found[given] = PREFIX + nearest[0] if nearest else None
    return found


def complaint(given: str, nearest: str | None) -> str:
    """What is wrong with such a variable."""
    hint = f"; did you mean {nearest}?" if nearest else ""
    return f"{given} is no setting, and is ignored{hint}"
