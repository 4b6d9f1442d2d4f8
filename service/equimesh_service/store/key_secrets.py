"""API keys: their secrets, ids and scopes."""

import hmac
import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256

# To look at meshes and samples.
READ = "read"
# To request, cancel and delete them, too.
WRITE = "write"
# To see those of all keys, too, and the metrics.
ADMIN = "admin"
SCOPES = (READ, WRITE, ADMIN)
# The scopes that a scope includes.
_INCLUDED = {READ: {READ}, WRITE: {READ, WRITE}, ADMIN: {READ, WRITE, ADMIN}}
# How many meshes a key starts while another key starts one, when both have meshes waiting.
DEFAULT_SHARE = 1
# Larger shares would starve other keys for long.
MAX_SHARE = 100
_SECRET = re.compile(r"em_([0-9a-f]{12})_[A-Za-z0-9_-]{43}")


@dataclass(frozen=True, kw_only=True)
class KeyRow:
    """A key as it is stored, with the hash of its secret."""

    id: str
    name: str
    sha256: str
    scopes: tuple[str, ...]
    created_at: float
    revoked_at: float | None = None
    share: int = DEFAULT_SHARE

    def is_valid(self, mark: str) -> bool:
        """Whether the key has the secret with this hash, and is not revoked."""
        # In a time that does not depend on the hashes.
        return hmac.compare_digest(self.sha256, mark) and self.revoked_at is None


def check_share(share: int) -> None:
    """Raise ValueError for a share out of its bounds."""
    if not 1 <= share <= MAX_SHARE:
        raise ValueError(f"the share of a key is 1 to {MAX_SHARE}, not {share}")


def new_secret() -> tuple[str, str]:
    """A new id, and a secret that contains it: 256 random bits, so that a plain hash hides them."""
    key_id = secrets.token_hex(6)
    return key_id, f"em_{key_id}_{secrets.token_urlsafe(32)}"


def id_of(secret: str) -> str | None:
    """The id in a secret, None for a text that is no secret."""
    match = _SECRET.fullmatch(secret)
    return None if match is None else match[1]


def digest(secret: str) -> str:
    """The SHA-256 of a secret, as it is stored."""
    return sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def expand_scopes(scopes: Iterable[str]) -> frozenset[str]:
    """These scopes and all that they include: write includes read, admin includes both."""
    return frozenset[str]().union(*(_INCLUDED[scope] for scope in scopes))
