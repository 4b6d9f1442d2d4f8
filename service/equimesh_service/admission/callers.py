"""The caller behind a request, and the short memory that spares the store most questions about keys."""

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from starlette.concurrency import run_in_threadpool

from equimesh_service.problems.problem import Problem
from equimesh_service.store.key_secrets import ADMIN, SCOPES, digest, expand_scopes, id_of
from equimesh_service.store.keys import KeyStore

# A revoked key works no longer than this, and a first key closes an open service this soon.
_REMEMBERED_SECONDS = 1.0
# Secrets, good and bad, that are remembered at most.
_MAX_REMEMBERED = 1000


@dataclass(frozen=True)
class Caller:
    """The caller of a request: the id of an API key ("" for none), its scopes, and the hash of its secret."""

    key_id: str
    scopes: frozenset[str]
    mark: str = field(default="", repr=False)

    @property
    def admin(self) -> bool:
        """Whether all meshes and samples are the caller's to see."""
        return ADMIN in self.scopes

    def sees(self, key_id: str) -> bool:
        """Whether what belongs to this key is there for the caller."""
        return self.admin or key_id == self.key_id

    @property
    def only(self) -> str | None:
        """The one key whose things the caller sees; None for all."""
        return None if self.admin else self.key_id


ANYONE = Caller("", frozenset(SCOPES))


class Callers:
    """Tells callers by their secrets. For one event loop; ``clock`` gives seconds that only grow."""

    def __init__(self, store: KeyStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._clock = clock
        self._known: OrderedDict[str, tuple[Caller | None, float]] = OrderedDict()  # by the hashes of secrets
        self._exist = False
        self._looked_at = float("-inf")

    async def identify(self, secret: str | None) -> Caller:
        """The caller with this secret; raises a 401 problem. While no key was ever created, anyone."""
        key_id = None if secret is None else id_of(secret)
        caller = None if secret is None or key_id is None else await self._known_as(key_id, digest(secret))
        if caller is not None:
            return caller
        if not await self._needed():
            return ANYONE
        detail = "This needs an API key." if secret is None else "This API key is not known, or was revoked."
        raise Problem("unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})

    async def stands(self, caller: Caller) -> bool:
        """Whether a caller of a while ago would still be let in."""
        if caller.key_id:
            return await self._known_as(caller.key_id, caller.mark) is not None
        return not await self._needed()

    async def _needed(self) -> bool:
        now = self._clock()
        if not self._exist and now - self._looked_at >= _REMEMBERED_SECONDS:
            self._exist = await run_in_threadpool(self._store.exist)  # once true it stays so
            self._looked_at = now
        return self._exist

    async def _known_as(self, key_id: str, mark: str) -> Caller | None:
        """The caller with this key, if its hash is this one and it is in force; in most cases without a look."""
        now = self._clock()
        found = self._known.get(mark)
        if found is not None and now < found[1]:
            return found[0]
        row = await run_in_threadpool(self._store.get, key_id)
        caller = Caller(key_id, expand_scopes(row.scopes), mark) if row is not None and row.opened_by(mark) else None
        # The time counts from before the look: a key that is revoked after it is let in no longer than that.
        self._known[mark] = (caller, now + _REMEMBERED_SECONDS)
        self._known.move_to_end(mark)
        while len(self._known) > _MAX_REMEMBERED:
            self._known.popitem(last=False)
        return caller
