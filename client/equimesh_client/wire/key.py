"""The API key of a client: its environment variable, and its request header."""

import os
from collections.abc import Mapping

from equimesh_client.errors import BadArgument

VARIABLE = "EQUIMESH_KEY"
HEADER = "Authorization"


def headers_with_key(headers: Mapping[str, str] | None, key: str | None) -> dict[str, str]:
    """The headers of every request, with the API key.

    ``key`` is by default that of the environment variable; an empty one is none. Headers with their own authorisation
    take precedence over the environment. Raises :class:`BadArgument` for two keys, and for a character that keys do not
    have; the message does not contain the key.
    """
    merged = dict(headers or {})
    own = any(name.lower() == HEADER.lower() for name in merged)
    secret = (os.environ.get(VARIABLE, "") if key is None and not own else key or "").strip()
    if not secret:
        return merged
    if own:
        raise BadArgument("give a key, or a header Authorization, not both")
    if not all("!" <= sign <= "~" for sign in secret):
        raise BadArgument(f"the key has a space or another character that no key has; check the value of {VARIABLE}")
    return {**merged, HEADER: f"Bearer {secret}"}
