"""The callers of requests, by their API keys, with a cache that spares the store most queries."""

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from starlette.concurrency import run_in_threadpool

from equimesh_service.problems.problem import Problem
from equimesh_service.store.key_secrets import ADMIN, DEFAULT_SHARE, SCOPES, digest, expand_scopes, id_of
from equimesh_service.store.keys import KeyStore

# How long a caller is cached: after this time a revoked key is refused, and the first key closes an open service.
_CACHE_SECONDS = 1.0
# The most secrets in the cache, valid and invalid.
_MAX_CACHED = 1000


@dataclass(frozen=True)
class Caller:
    """The caller of a request: the id of an API key ("" for none), its scopes, the hash of its secret, its share."""

    key_id: str
    scopes: frozenset[str]
    mark: str = field(default="", repr=False)
    share: int = DEFAULT_SHARE

    @property
    def admin(self) -> bool:
        """Whether the caller sees the meshes and samples of all keys."""
        return ADMIN in self.scopes

    def sees(self, key_id: str) -> bool:
        """Whether the caller sees what belongs to this key."""
        return self.admin or key_id == self.key_id

    @property
    def only(self) -> str | None:
        """The key whose meshes and samples the caller sees; None for all keys."""
        return None if self.admin else self.key_id


ANYONE = Caller("", frozenset(SCOPES))


class Callers:
    """Identifies callers by their secrets. For one event loop; ``clock`` returns monotonic seconds."""

    def __init__(self, store: KeyStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._clock = clock
        self._cache: OrderedDict[str, tuple[Caller | None, float]] = OrderedDict()  # by the hashes of secrets
        self._exist = False
        self._looked_at = float("-inf")

    async def identify(self, secret: str | None) -> Caller:
        """The caller with this secret, :data:`ANYONE` before the first key is created; raises a 401 problem."""
        key_id = None if secret is None else id_of(secret)
        caller = None if secret is None or key_id is None else await self._find(key_id, digest(secret))
        if caller is not None:
            return caller
        if not await self.keys_exist():
            return ANYONE
        detail = "This needs an API key." if secret is None else "This API key is not known, or was revoked."
        raise Problem("unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})

    async def is_valid(self, caller: Caller) -> bool:
        """Whether a caller who was identified earlier is still allowed in."""
        if caller.key_id:
            return await self._find(caller.key_id, caller.mark) is not None
        return not await self.keys_exist()

    async def keys_exist(self) -> bool:
        """Whether a key was ever created, so that every request needs one; true a second after the first at most."""
        now = self._clock()
        if not self._exist and now - self._looked_at >= _CACHE_SECONDS:
            self._exist = await run_in_threadpool(self._store.exist)  # once true, it stays true
            self._looked_at = now
        return self._exist

    async def _find(self, key_id: str, mark: str) -> Caller | None:
        """The caller with this key and this hash; None for an unknown or revoked key. Most calls need no query."""
        now = self._clock()
        found = self._cache.get(mark)
        if found is not None and now < found[1]:
            return found[0]
        row = await run_in_threadpool(self._store.get, key_id)
        caller = None
        if row is not None and row.is_valid(mark):
            caller = Caller(key_id, expand_scopes(row.scopes), mark, row.share)
        # From before the query, so that a key that is revoked during it is refused in time.
        self._cache[mark] = (caller, now + _CACHE_SECONDS)
        self._cache.move_to_end(mark)
        while len(self._cache) > _MAX_CACHED:
            self._cache.popitem(last=False)
        return caller
