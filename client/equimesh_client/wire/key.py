"""The API key of a client: where it comes from, and the one header that it is in."""

from __future__ import annotations

import os
from collections.abc import Mapping

from equimesh_client.errors import BadArgument

VARIABLE = "EQUIMESH_KEY"
HEADER = "Authorization"


def with_key(headers: Mapping[str, str] | None, key: str | None) -> dict[str, str]:
    """The headers of every request. ``key`` unless given is that of the environment; an empty one is none, and so is
    that of the environment where the headers have an authorisation of their own.

    Raises :class:`BadArgument` when there are two, or the key cannot be one; what it is, is never told.
    """
    made = dict(headers or {})
    own = any(name.lower() == HEADER.lower() for name in made)
    secret = (os.environ.get(VARIABLE, "") if key is None and not own else key or "").strip()
    if not secret:
        return made
    if own:
        raise BadArgument("give a key, or a header Authorization, not both")
    if not all("!" <= sign <= "~" for sign in secret):
        raise BadArgument(f"the key has a space or another sign that no key has; look at how it came into {VARIABLE}")
    return {**made, HEADER: f"Bearer {secret}"}
